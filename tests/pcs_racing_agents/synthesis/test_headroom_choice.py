"""An archive chosen for headroom: an ordinary archive, made by a job like any other."""

import numpy as np
import pytest
from long_jobs import files
from refusal import refused

from pcs_racing import load_archive
from pcs_racing.testing import check_archive
from pcs_racing_agents.jobs.executors import make_executor
from pcs_racing_agents.payoffs.headroom import headroom
from pcs_racing_agents.payoffs.policy_pool import PolicyPool, pool_payoffs
from pcs_racing_agents.synthesis.archive_run import make_archive
from pcs_racing_agents.synthesis.config import ArchiveConfig, load_archive_config
from pcs_racing_agents.synthesis.selection import best_of_each_interval

pytest.importorskip("cma")
pytest.importorskip("moocore")

TINY = ArchiveConfig(
    name="tiny", preset="contest", tracks=("Pipkin",), duration=4.0, final_duration=4.0, segment_seconds=2.0,
    generations=1, population=4, initial_sample=16, opponents=1, starts=1, crash_limit=1.0, selection="headroom",
    candidates=8, groups=2, payoff_races=16, judging_races=32, judging_tracks=("Tarnfjord",), final_opponents=1,
    final_starts=1, min_policies=3, max_policies=4, seed=5,
)  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """An archive, its folder, and the news told on the way."""
    folder, news = tmp_path_factory.mktemp("archive") / "made", []
    return make_archive(TINY, folder, callback=news.append), folder, news


def test_it_is_an_ordinary_archive_whose_manifest_says_how_it_was_chosen(made):
    archive = load_archive(made[1])
    check_archive(archive)
    assert len(archive) == 4
    assert archive.characteristics == TINY.axes
    assert (np.diff(archive.coordinates[:, 0]) >= 0.0).all()
    assert len(archive.explored.parameters) == 16 + 4
    assert archive.own_crash.shape == (4,)
    assert all((archive.explored.parameters == theta).all(axis=1).any() for theta in archive.parameters)
    settings = made[0].settings
    assert settings["selection"] == "headroom"
    assert settings["choice_candidates"] == 8
    assert set(settings["track_hashes"].replace(",", "").split()) >= {"Pipkin", "Tarnfjord"}
    for name in ("headroom", "headroom_elsewhere"):
        assert settings[name.replace("headroom", "headroom_low")] <= settings[name] + 1e-9
        assert name.replace("headroom", "transitive_share") in settings
    assert float(settings["headroom_Tarnfjord"].split()[0]) == pytest.approx(settings["headroom_elsewhere"], abs=5e-4)


def test_its_headroom_is_judged_on_races_that_chose_nobody(made):
    """The races of the choice, of the judgement and of another seed are different ones."""
    chunks = {name: sorted((made[1] / "job" / "chunks").glob(f"{name}-*.npz")) for name in ("choice", "judgement")}
    first = {name: np.load(files[0])["payoffs"] for name, files in chunks.items()}
    assert first["choice"].shape[1] == 8
    assert first["judgement"].shape[1] == 16
    policies = tuple(made[0].policy(k) for k in range(4))
    again = PolicyPool(policies, ("Tarnfjord",), TINY.rules_of(4.0), races=32, seed=3)
    assert abs(headroom(pool_payoffs(again)[0]).value - made[0].settings["headroom_elsewhere"]) < 0.3


def test_the_executor_has_no_influence_and_a_finished_run_races_nothing(made, tmp_path, monkeypatch):
    with make_executor("threads", 2) as executor:
        make_archive(TINY, tmp_path / "again", executor=executor)
    assert files(tmp_path / "again") == files(made[1])
    monkeypatch.setattr("pcs_racing_agents.synthesis.evaluate.advance", None)
    monkeypatch.setattr("pcs_racing_agents.payoffs.policy_pool.advance", None)
    make_archive(TINY, tmp_path / "again")
    assert files(tmp_path / "again") == files(made[1])


def test_candidates_are_the_best_of_each_interval_and_too_few_are_told(tmp_path):
    axis = np.array([0.0, 0.1, 0.2, 0.3, 0.6, 0.9, 1.0])
    score = np.array([0.5, 0.9, 0.1, 0.8, 0.0, 0.3, 0.2])
    # Two intervals: 0, 1, 2, 3 and 4, 5, 6. They take turns, each with its best.
    assert best_of_each_interval(axis, score, 4, 2).tolist() == [1, 3, 5, 6]
    assert best_of_each_interval(axis, score, 7, 2).tolist() == list(range(7))
    assert best_of_each_interval(axis, score, 1, 2).tolist() == [1]
    # Of 28 pairs of candidates and 6 of chosen ones, so many races of 4 s.
    work = {"search": 20 * 2 * 4.0, "choice": 28 * 16 * 4.0, "measurement": 4 * 2 * 4.0, "judgement": 6 * 2 * 32 * 4.0}
    assert work == TINY.work
    refused(
        "8 candidates differ in speed",
        make_archive,
        load_archive_config(TINY, initial_sample=8, generations=0, max_policies=10, candidates=10),
        tmp_path,
    )


def test_impossible_settings_are_refused():
    for changes, value in [
        ({"max_policies": 2, "min_policies": 2, "groups": 1}, "2"), ({"candidates": 3}, "3"), ({"groups": 5}, "5"),
        ({"payoff_races": 22}, "22"), ({"judging_races": 50}, "50"),
        ({"judging_tracks": ("Pipkin",)}, "Pipkin"), ({"selection": "luck"}, "luck"),
    ]:  # fmt: skip
        refused(value, load_archive_config, TINY, **changes)
