"""The way of a move: from ``predict`` to the kernel in at most seven files, none twice, and checked
once.
"""

import inspect
from pathlib import Path

import numpy as np
import pytest
from same_move import Model

import pcs_racing
from pcs_racing.envs import game_batch
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv, HeadToHeadEnv
from pcs_racing.game import players, rules
from pcs_racing.race import driving

HOME = Path(pcs_racing.__file__).resolve().parent
SHORT = {"steps": (0.1,) * 2, "stay": True}


def watch(monkeypatch) -> tuple[list[list[str]], list[np.ndarray], list[np.ndarray]]:
    """Record the files on the way to each call of the kernel, checked moves, and parameters."""
    ways: list[list[str]] = []
    checked: list[np.ndarray] = []
    advance, check = driving.advance_races, rules.check_moves

    def kernel(track, races, *rest):
        names = [
            frame.filename
            for frame in reversed(inspect.stack())
            if Path(frame.filename).is_relative_to(HOME)
        ]
        files = [str(Path(name).relative_to(HOME)) for name in names]
        ways.append([file for i, file in enumerate(files) if i == 0 or files[i - 1] != file])
        thetas.append(races.theta.copy())
        advance(track, races, *rest)

    def checking(moves, *rest, **more):
        checked.append(np.asarray(moves))
        return check(moves, *rest, **more)

    thetas: list[np.ndarray] = []
    monkeypatch.setattr(driving, "advance_races", kernel)
    for module in (rules, players, game_batch):
        monkeypatch.setattr(module, "check_moves", checking)
    return ways, checked, thetas


@pytest.mark.parametrize("kind", ["scalar", "vector", "pair"])
def test_a_move_passes_seven_rooms_at_most_and_none_twice(coarse_oval, monkeypatch, kind):
    given, move = {"track": coarse_oval, **SHORT}, 0
    kinds = {
        "scalar": DuelEnv,
        "vector": lambda **a: DuelVectorEnv(1, threads=1, **a),
        "pair": HeadToHeadEnv,
    }
    env = kinds[kind](**given, **({} if kind == "pair" else {"opponent": Model(1)}))
    env.reset(seed=0, options={"policies": (0, 5)})
    ways, checked, thetas = watch(monkeypatch)
    actions = Model(move).predict(np.zeros((1, 1)))[0]
    env.step(
        {
            "scalar": int(actions[0]),
            "vector": actions,
            "pair": {"car_0": int(actions[0]), "car_1": 1},
        }[kind]
    )
    # The kernel receives the policy that each car's move leads to.
    table = env.game.table
    expected = env.game.theta(np.array([table[0, 0], table[5, 1]]))
    np.testing.assert_array_equal(thetas[-1][0], expected)
    way = ["agent", *ways[-1], "race/kernel.py"]
    assert len(way) <= 7, way
    assert len(set(way)) == len(way), f"a room is entered twice: {way}"
    assert way[-3:] == ["game/rules.py", "race/driving.py", "race/kernel.py"]
    # Each player's move is checked once: at the door of the environment, or where the opponent is
    # asked.
    assert sorted(np.concatenate([moves.ravel() for moves in checked]).tolist()) == [0, 1]
