import numpy as np

from pcs_racing_agents.agents import observing


def test_observations_are_read_as_the_game_writes_them(game, seen):
    names = [element.name for element in game.observation_elements]
    for step, rows in enumerate(seen):
        running = rows[:, names.index(f"seen_{step}")] == 1.0  # games that crashed stay behind
        assert running.any()
        np.testing.assert_array_equal(observing.moves_made(rows, 2)[running], step)
        for coordinates, name in ((observing.own, "own"), (observing.opponent, "opponent")):
            at = [names.index(f"{name}_{axis}_{step}") for axis in ("aggressiveness", "restraint")]
            np.testing.assert_array_equal(coordinates(rows, 2)[running], rows[running][:, at])
            np.testing.assert_array_equal(coordinates(rows, 2, step)[running], rows[running][:, at])
    assert observing.step_count(seen[0], 2) == 5


def test_what_was_seen_earlier_and_the_own_policy_are_known(seen, game, setting):
    last = seen[-1]
    count = observing.moves_made(last, 2)
    for step, rows in enumerate(seen[:-1]):
        long_enough = count >= step
        np.testing.assert_array_equal(observing.earlier(last, 2, step)[long_enough], rows[long_enough])
    state = game.reset(games=10, seed=3)
    rows = game.observation(state)[:, 1]
    np.testing.assert_array_equal(setting.archive.nearest(observing.own(rows, 2)), state.policy[:, 1])
