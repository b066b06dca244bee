"""Infos of a batch of games, and draws and calls of opponents; quick as plain
Python, too.
"""

import numpy as np
import pytest

from pcs_racing.envs.game_batch import GameBatch, GameOptions
from pcs_racing.envs.infos import Crash, Result, words
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.planners.registry import get_planner

MOVES = ("aggressiveness +", "aggressiveness -", "restraint +", "restraint -", "stay")


@pytest.fixture(scope="module")
def archive() -> PolicyArchive:
    """Six policies of pure pursuit, from slow to fast."""
    planner = get_planner("pure-pursuit")
    pace = np.linspace(0.1, 0.9, 6)
    parameters = np.array([planner.policy({"pace": value}).parameters for value in pace])
    coordinates = np.column_stack([pace, 1.0 - pace + 0.3 * np.sin(9.0 * pace)])
    return PolicyArchive(
        "six",
        "pure-pursuit",
        planner.parameter_names,
        parameters,
        ("aggressiveness", "restraint"),
        coordinates,
    )


def make(track, archive, opponent="random-moves", games=6, **settings):
    settings = {"rules": "contest", "steps": (0.1,) * 3} | settings
    options = GameOptions.read(
        {"track": track, "archive": archive, "opponent": opponent, **settings}
    )
    return GameBatch(games, options, threads=1, players=2 if opponent is None else 1)


def begin(batch, seed=0):
    rngs = [np.random.default_rng([seed, k]) for k in range(batch.episodes)]
    batch.restart(np.arange(batch.episodes), rngs)
    return rngs


def test_the_info_says_how_each_game_ended_for_either_car(coarse_oval, archive):
    """Won, lost, too close, a crash with one to blame, with two, and an open race."""
    batch = make(coarse_oval, archive, opponent=None)
    begin(batch)
    state = batch.state
    state.step[:] = [2, 2, 2, 1, 1, 1]
    state.race.progress[:] = [
        [5.0, 3.0],
        [3.0, 5.0],
        [3.0, 3.001],
        [9.0, 1.0],
        [9.0, 1.0],
        [9.0, 1.0],
    ]
    state.race.crash[:] = [[0, 0], [0, 0], [0, 0], [1, 0], [2, 2], [0, 0]]
    state.race.fault[:] = [[0, 0], [0, 0], [0, 0], [1, 0], [1, 1], [0, 0]]
    batch.moves[:] = [[0, 1], [2, 3], [4, 0], [1, 2], [3, 4], [-1, -1]]
    infos = batch.infos()
    own, other = ({name: values[car::2] for name, values in infos.items()} for car in range(2))
    win, tie, loss, crash, running = (
        Result.WIN,
        Result.TIE,
        Result.LOSS,
        Result.CRASH,
        Result.RUNNING,
    )
    assert own["result"].tolist() == [win, loss, tie, loss, crash, running]
    assert other["result"].tolist() == [loss, win, tie, win, crash, running]
    assert own["move"].tolist() == [0, 2, 4, 1, 3, -1]
    assert own["opponent_move"].tolist() == [1, 3, 0, 2, 4, -1]
    assert own["lead"].tolist() == pytest.approx([2.0, -2.0, -0.001, 8.0, 8.0, 8.0])
    assert own["crash"].tolist() == [0, 0, 0, Crash.WALL, Crash.CAR, 0]
    assert own["fault"].tolist() == [0, 0, 0, 1, 1, 0]
    assert other["fault"].tolist() == [0, 0, 0, 0, 1, 0]
    assert own["policy"].tolist() == state.policy[:, 0].tolist()
    for one, two in (("move", "opponent_move"), ("crash", "opponent_crash")):
        assert own[one].tolist() == other[two].tolist()
        assert own[two].tolist() == other[one].tolist()
    np.testing.assert_allclose(other["lead"], -own["lead"])
    assert own["opponent"].tolist() == [-1] * 6
    said = words(batch.info(6), batch.codes)  # of car 0 in game 3
    assert (said["result"], said["crash"], said["opponent_crash"]) == ("loss", "wall", "none")
    assert (said["move"], said["opponent_move"], said["opponent"]) == (MOVES[1], MOVES[2], "none")
    assert own["action_mask"].shape == (6, 5)
    np.testing.assert_array_equal(own["action_mask"], batch.game.action_mask(state)[:, 0])
    for environment in range(12):
        one = batch.info(environment)
        mask = one.pop("action_mask")
        assert one == {name: infos[name][environment] for name in infos if name != "action_mask"}
        np.testing.assert_array_equal(mask, infos["action_mask"][environment])
