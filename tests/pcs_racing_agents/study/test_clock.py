"""Times of stages survive a stop and a kill."""

import time

import pytest

from pcs_racing_agents.study import run
from pcs_racing_agents.study.run import seconds_counted


def test_time_before_a_stop_is_counted(tmp_path):
    file = tmp_path / "seconds.txt"
    with pytest.raises(KeyboardInterrupt), seconds_counted(file):
        raise KeyboardInterrupt
    file.write_text(f"{float(file.read_text()) + 100.0}\n")
    with seconds_counted(file) as spent:
        assert 100.0 <= spent() < 200.0
        assert file.exists()
    assert not file.exists()
    with seconds_counted(file) as spent:
        assert spent() < 50.0


def test_a_kill_loses_little(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "BEAT", 0.01)
    file = tmp_path / "seconds.txt"
    with seconds_counted(file):
        deadline = time.monotonic() + 30.0
        while not file.exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        assert float(file.read_text()) >= 0.0  # written while the work goes on


@pytest.mark.parametrize("text", ["", "soon", "-3", "nan", "1e99"])
def test_nonsense_counts_as_nothing(tmp_path, text):
    file = tmp_path / "seconds.txt"
    file.write_text(text)
    with seconds_counted(file) as spent:
        assert spent() < 50.0
