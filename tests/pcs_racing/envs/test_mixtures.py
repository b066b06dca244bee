"""Opponents of several planners in one environment: one is drawn for each race and drives it to its
end.
"""

import copy

import numpy as np
import pytest
from refusal import refused

from pcs_racing.envs.drive import DriveEnv, DriveHeadToHeadEnv, DriveVectorEnv
from pcs_racing.envs.duel import DuelVectorEnv
from pcs_racing.envs.models import model_policy
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.registry import get_planner

FAMILIES = [(2, "lattice"), (1, "predictive-spliner"), (1, "lane-switcher")]
CRAWLER = Planner("crawler", (), drive=lambda track, theta, view, memory: (0.0, 0.5)).policy()
STRAIGHT = model_policy(lambda seen: 0.0 * seen[:, :2], name="straight", time_step=0.2)
KINDS = {
    "compiled": FAMILIES,
    "python": [*FAMILIES, (2, CRAWLER), (2, STRAIGHT)],
    "moves": ["random-moves", "pure-pursuit", CRAWLER],
}
SHORT = {"track": "Tarnfjord", "duration": 1.0}


def actions(steps, envs):
    rng = np.random.default_rng(3)
    return rng.uniform((-0.2, 0.0), (0.2, 0.8), (steps, envs, 2)).astype(np.float32)


def rollout(envs, given, seed):
    """Observations of each step, shape (steps + 1, B, 41), and the opponents of each step."""
    seen, opponents = [envs.reset(seed=seed)[0]], [envs.batch.drawn.copy()]
    for action in given:
        seen.append(envs.step(action)[0])
        opponents.append(envs.batch.drawn.copy())
    return np.array(seen), np.array(opponents)


def batch(count, opponent, **more):
    return DriveVectorEnv(count, opponent=opponent, autoreset_mode="SAME_STEP", **SHORT, **more)


@pytest.mark.parametrize("opponent", KINDS.values(), ids=KINDS)
def test_a_race_is_the_same_alone_and_in_batches_of_any_size(opponent):
    envs, given = batch(10, opponent), actions(24, 10)
    seen, drawn = rollout(envs, given, seed=5)
    assert len(np.unique(drawn)) == len(opponent)
    part, _ = rollout(batch(2, opponent), given[:, 4:6], seed=9)
    np.testing.assert_array_equal(part, seen[:, 4:6])
    env = DriveEnv(opponent=opponent, **SHORT)
    alone = [env.reset(seed=8)[0]]
    for action in given[:9, 3]:  # the race ends after 10 steps
        alone.append(env.step(action)[0])
    np.testing.assert_array_equal(alone, seen[:10, 3])


def test_a_race_against_one_of_several_is_the_race_against_it_alone():
    """Its parameters, its memory and the other planners of the batch change nothing."""
    start = {"start": (20.0, 0)}
    mixed, given = batch(12, FAMILIES), np.tile(np.float32([0.0, -0.8]), (9, 12, 1))
    mixed.reset(seed=1, options=start)
    alone = [batch(12, name) for _, name in FAMILIES]
    for envs in alone:
        envs.reset(seed=1, options=start)
    for action in given:
        seen, *_ = mixed.step(action)
        each = np.array([envs.step(action)[0] for envs in alone])
    rows = np.flatnonzero(mixed.batch.state.tick == 90)  # no crash so far
    drawn = mixed.batch.drawn[rows]
    assert set(drawn) == {0, 1, 2}
    np.testing.assert_array_equal(seen[rows], each[drawn, rows])
    assert not (each[0] == each[1]).all()


def test_an_opponent_drives_its_race_to_the_end_and_weights_say_how_often_it_comes():
    envs = batch(400, FAMILIES)
    _, drawn = rollout(envs, actions(9, 400), seed=0)  # 0.9 s of 1 s
    ended = envs.batch.state.tick < 90
    np.testing.assert_array_equal(drawn[0, ~ended], drawn[-1, ~ended])
    assert np.bincount(drawn[0]) / 400 == pytest.approx([0.5, 0.25, 0.25], abs=0.08)
    assert DriveEnv(opponent=FAMILIES).unwrapped.batch.codes["opponent"][1] == "predictive-spliner"


def test_new_weights_hold_for_the_races_that_begin_later():
    envs, given = batch(8, FAMILIES), actions(12, 8)
    envs.reset(seed=2)
    before = envs.batch.drawn.copy()
    envs.set_opponent_weights([1e-9, 1e-9, 1.0])
    kept = copy.deepcopy(envs)
    np.testing.assert_array_equal(envs.batch.drawn, before)
    for action in given:
        envs.step(action)
    assert set(envs.batch.drawn) == {2}
    for action in given:
        kept.step(action)
    np.testing.assert_array_equal(kept.batch.state.cars, envs.batch.state.cars)
    duels = DuelVectorEnv(30, opponent=["never-switch", "random-moves"])
    duels.set_opponent_weights([1e-9, 1.0])
    duels.reset(seed=0)
    assert set(duels.batch.drawn) == {1}
    for wrong in ([1.0, 2.0], [1.0, 0.0, 1.0], [1.0, np.nan, 1.0], "often", None):
        refused("they must be 3 numbers from 1e-12 to 1e", envs.set_opponent_weights, wrong)


def test_several_agents_race_against_one_of_several():
    env = DriveHeadToHeadEnv(opponent=FAMILIES, cars=3, time_step=0.1, **SHORT)
    names = set()
    for seed in range(12):
        env.reset(seed=seed)
        env.step({agent: np.array([0.0, 0.3], np.float32) for agent in env.agents})
        names.add(env.batch.opponents[env.batch.drawn[0]].name)
    assert names == {"lattice", "predictive-spliner", "lane-switcher"}
    lists = ["lattice", ["lattice", "pure-pursuit"]]
    refused("in a race of 3 cars each is one planner, no list", DriveEnv, opponents=lists)


def test_the_error_of_a_planner_names_the_race_and_the_planner():
    def fail(track, theta, view, memory):
        raise ValueError("no idea")

    lost = Planner("lost", (), drive=fail).policy()
    envs = batch(8, [get_planner("lattice").policy(), lost])
    envs.reset(seed=0)
    race = int(np.flatnonzero(envs.batch.drawn == 1)[0])
    message = f"race {race}, car 1: planner 'lost' raised ValueError: no idea"
    refused(message, envs.step, actions(1, 8)[0])
