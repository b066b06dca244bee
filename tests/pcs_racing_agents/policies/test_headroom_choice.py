"""An archive chosen for headroom: an ordinary archive, made by a job like any other."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from long_jobs import files
from refusal import refused

from pcs_racing import load_archive
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.testing import check_archive
from pcs_racing_agents.base.executors import make_executor
from pcs_racing_agents.policies.archive_run import make_archive
from pcs_racing_agents.policies.archive_search import ArchiveProgress
from pcs_racing_agents.policies.choosing import choose_pool, denoised, pool_headroom
from pcs_racing_agents.policies.config import ArchiveConfig, load_archive_config
from pcs_racing_agents.policies.evaluate import Evaluation
from pcs_racing_agents.policies.headroom import headroom, transitive_share
from pcs_racing_agents.policies.policy_pool import PolicyPool, pool_payoffs
from pcs_racing_agents.policies.selection import (
    best_of_each_interval,
    choose_for_headroom,
    judge_headroom,
)

pytest.importorskip("cma")
pytest.importorskip("moocore")

TINY = ArchiveConfig(
    name="tiny",
    preset="contest",
    tracks=("Pipkin",),
    duration=4.0,
    final_duration=4.0,
    segment_seconds=2.0,
    generations=1,
    population=4,
    initial_sample=16,
    opponents=1,
    starts=1,
    crash_limit=1.0,
    selection="headroom",
    candidates=8,
    groups=2,
    payoff_races=16,
    judging_races=32,
    judging_tracks=("Tarnfjord",),
    final_opponents=1,
    final_starts=1,
    min_policies=3,
    max_policies=4,
    seed=5,
)


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
    assert all(
        (archive.explored.parameters == theta).all(axis=1).any() for theta in archive.parameters
    )
    settings = made[0].settings
    assert settings["selection"] == "headroom"
    assert settings["choice_candidates"] == 8
    assert set(settings["track_hashes"].replace(",", "").split()) >= {"Pipkin", "Tarnfjord"}


def test_its_headroom_is_judged_on_races_that_chose_nobody(made):
    """The races of the choice, of the judgement and of another seed are different ones."""
    chunks = {
        name: sorted((made[1] / "job" / "chunks").glob(f"{name}-*.npz"))
        for name in ("choice", "judgement")
    }
    first = {name: np.load(files[0])["payoffs"] for name, files in chunks.items()}
    assert first["choice"].shape[1] == 8
    assert first["judgement"].shape[1] == 16
    policies = tuple(made[0].policy(k) for k in range(4))
    again = PolicyPool(policies, ("Tarnfjord",), TINY.rules_of(4.0), races=32, seed=3)
    assert (
        abs(headroom(pool_payoffs(again)[0]).value - made[0].settings["headroom_elsewhere"]) < 0.3
    )


def test_the_executor_has_no_influence_and_a_finished_run_races_nothing(
    made, tmp_path, monkeypatch
):
    with make_executor("threads", 2) as executor:
        make_archive(TINY, tmp_path / "again", executor=executor)
    assert files(tmp_path / "again") == files(made[1])
    monkeypatch.setattr("pcs_racing_agents.policies.evaluate.advance", None)
    monkeypatch.setattr("pcs_racing_agents.policies.policy_pool.advance", None)
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
    work = {
        "search": 20 * 2 * 4.0,
        "choice": 28 * 16 * 4.0,
        "measurement": 4 * 2 * 4.0,
        "judgement": 6 * 2 * 32 * 4.0,
    }
    assert work == TINY.work
    refused(
        "8 candidates differ in speed",
        make_archive,
        load_archive_config(TINY, initial_sample=8, generations=0, max_policies=10, candidates=10),
        tmp_path,
    )


def antisymmetric(rng, *shape):
    half = rng.uniform(-0.25, 0.25, shape)
    return half - np.swapaxes(half, -1, -2)


def stub(config, payoffs, explored=None):
    """Races of a synthesis that are made up; and the pools and news that were asked for and told."""
    pools, news = [], []
    last = ArchiveProgress("search", 1, 1, 20, 0.7, 5, 0.1, 0.5)
    races = SimpleNamespace(
        config=config,
        history=[last],
        callback=news.append,
        explored=lambda: explored,
        payoffs=lambda stage, pool: pools.append((stage, pool)) or payoffs,
        note=lambda *told: news.append(told),
    )
    return races, pools, news


def test_the_pool_is_chosen_and_judged_by_the_payoffs_of_its_races():
    rng = np.random.default_rng(0)
    theta = LATTICE.bounds[:, 0] + rng.uniform(size=(30, 17)) * np.ptp(LATTICE.bounds, axis=1)
    explored = Evaluation(
        rng.uniform(size=(30, 2)),
        rng.uniform(size=30),
        rng.uniform(size=(30, 2)),
        *rng.uniform(size=(2, 30)),
    )
    allowed, payoffs = np.arange(2, 28), antisymmetric(rng, 1, 8, 8, 8)
    races, pools, news = stub(TINY, payoffs, (theta, explored))
    chosen, notes = choose_for_headroom(races, allowed, 5)
    ((stage, pool),), (told,) = pools, news
    rows = allowed[
        best_of_each_interval(explored.coordinates[allowed, 0], explored.won[allowed], 8, 8)
    ]
    asked = (stage, pool.tracks, pool.races, pool.folds, pool.seed, pool.config)
    assert asked == ("choice", ("Pipkin",), 16, 8, 5, TINY.rules_of(4.0))
    np.testing.assert_array_equal([policy.parameters for policy in pool.policies], theta[rows])
    expected = denoised(payoffs[0])[None]
    best = choose_pool(expected, [np.arange(4), np.arange(4, 8)], 4, seed=5)
    np.testing.assert_array_equal(chosen, theta[rows[best]])
    assert notes == {
        "choice_candidates": 8,
        "choice_headroom": pool_headroom(expected, best[None]).mean(),
        "choice_headroom_of_all_candidates": pool_headroom(expected, np.arange(8)[None]).mean(),
    }
    assert told[:4] == ("choice", 1, 0.7, 4)
    np.testing.assert_array_equal(told[4].own_crash, explored.own_crash[rows[best]])
    for total, folds in ((4, 2), (24, 12), (60, 10), (68, 2), (96, 16)):
        races, pools, _ = stub(replace(TINY, payoff_races=total), payoffs, (theta, explored))
        choose_for_headroom(races, allowed, 5)
        assert (pools[0][1].races, pools[0][1].folds) == (total, folds)
    # The judgement: on a circuit of the choice and on another one, which can't say what is
    # transitive.
    strength = 0.1 * np.arange(4.0)
    payoffs = np.stack(
        [0.2 * antisymmetric(rng, 16, 4, 4) + strength[:, None] - strength, np.zeros((16, 4, 4))]
    )
    races, pools, news = stub(TINY, payoffs)
    notes = judge_headroom(races, chosen, 7)
    ((stage, pool),) = pools
    assert (stage, pool.tracks, pool.races, pool.folds, pool.seed) == (
        "judgement",
        ("Pipkin", "Tarnfjord"),
        32,
        16,
        7,
    )
    here, there = map(headroom, payoffs)
    assert notes == {
        "headroom": here.value,
        "headroom_low": here.low,
        "transitive_share": transitive_share(payoffs[0]),
        "headroom_elsewhere": there.value,
        "headroom_low_elsewhere": there.low,
        "transitive_share_elsewhere": "unknown",
        "headroom_Pipkin": f"{here.value:+.3f} +- {here.opponents_error:.3f}",
        "headroom_Tarnfjord": f"{there.value:+.3f} +- {there.opponents_error:.3f}",
    }
    assert news == [races.history[0]._replace(stage="judgement", done=1.0)]
    races, pools, _ = stub(replace(TINY, judging_tracks=None), payoffs[:1])
    assert set(judge_headroom(races, chosen, 7)) == {
        "headroom",
        "headroom_low",
        "transitive_share",
        "headroom_Pipkin",
    }


def test_impossible_settings_are_refused():
    for changes, value in [
        ({"max_policies": 2, "min_policies": 2, "groups": 1}, "max_policies is 2"),
        ({"candidates": 3}, "than there are candidates, 3"),
        ({"groups": 5}, "groups is 5, above max_policies, 4"),
        ({"payoff_races": 22}, "22"),
        ({"judging_races": 50}, "50"),
        ({"judging_tracks": ("Pipkin",)}, "Pipkin"),
        ({"selection": "luck"}, "luck"),
    ]:
        refused(value, load_archive_config, TINY, **changes)
    smallest = load_archive_config(TINY, max_policies=3, groups=3, candidates=3)
    assert smallest.work["choice"] == 3 * 16 * 4.0
