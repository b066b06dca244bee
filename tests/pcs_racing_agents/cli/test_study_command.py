"""``pcs-racing study``: what its options change in the settings."""

import pytest

from pcs_racing.base.errors import InputError
from pcs_racing_agents.cli.main import main


@pytest.fixture
def begun(monkeypatch):
    """The settings of studies that were begun, in place of their work."""
    studies = []

    def begin(config, *_arguments, **_options):
        studies.append(config)
        raise InputError("begun")

    monkeypatch.setattr("pcs_racing_agents.study.run_study", begin)
    return studies


def test_options_replace_archive_and_seed_and_add_circuits_to_the_table(begun, tmp_path):
    options = ["--archive", "default", "--seed", "7", "--unseen", "Vellindra"]
    assert main(["study", "contest-table", *options, "--out", str(tmp_path / "out")]) == 2
    (study,) = begun
    assert (study.archive, study.seed) == ("default", 7)
    assert study.tracks[-1] == "Vellindra"
    assert "Vellindra" not in study.circuits


@pytest.mark.parametrize("unseen", ["Nowhere", "Pipkin"])
def test_a_circuit_that_is_unknown_or_in_the_table_already_is_refused(tmp_path, capsys, unseen):
    assert main(["study", "contest-table", "--unseen", unseen, "--out", str(tmp_path / "out")]) == 2
    assert unseen in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
