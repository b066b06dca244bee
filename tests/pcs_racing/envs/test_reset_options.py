"""The options of a reset that say where the cars stand."""

from dataclasses import replace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import InputError, load_race_config
from pcs_racing.envs.batch import place_poses, poses_option, start_option
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.race.races import RaceSetup
from pcs_racing.track.frenet import X, Y


def test_a_start_is_for_all_episodes_or_for_each_and_poses_may_have_a_speed():
    assert start_option({}, 2) is None
    shared = start_option({"start": (3.0, 1)}, 2)
    assert (shared.s.tolist(), shared.side.tolist()) == ([3.0, 3.0], [1, 1])
    own = start_option({"start": [(3.0, 1), (5.0, 0)]}, 2)
    assert (own.s.tolist(), own.side.tolist()) == ([3.0, 5.0], [1, 0])
    standing, rolling = (
        [[1.0, 2.0, 0.5], [3.0, 4.0, 0.0]],
        [[1.0, 2.0, 0.5, 2.0], [3.0, 4.0, 0.0, 0.0]],
    )
    assert poses_option({}, 3) is None
    assert (
        poses_option({"poses": standing}, 3).tolist()
        == [[[1.0, 2.0, 0.5, 0.0], [3.0, 4.0, 0.0, 0.0]]] * 3
    )
    assert poses_option({"poses": [rolling] * 3}, 3).tolist() == [rolling] * 3


@pytest.fixture
def setup(oval):
    return RaceSetup(oval, load_race_config("paper"), (LATTICE, LATTICE))


def poses_at(track, first, second):
    """Poses of both cars, shape (1, 2, 4), from (s, d)."""
    return np.array([[[*track.to_cartesian(place), 0.0] for place in (first, second)]])


def test_poses_count_progress_and_keep_cars_out_of_walls_and_of_each_other(oval, setup):
    state = place_poses(setup, poses_at(oval, (3.0, 0.2), (7.0, -0.2)))
    assert state.progress[0] == pytest.approx([-4.0, 0.0], abs=0.01)
    assert state.frenet[0] == pytest.approx(np.array([[3.0, 0.2], [7.0, -0.2]]), abs=0.01)
    inside_each_other, in_a_wall = (
        poses_at(oval, (3.0, 0.0), (3.1, 0.0)),
        poses_at(oval, (7.0, 0.0), (3.0, 1.1)),
    )
    for poses in (inside_each_other, in_a_wall):
        refused("episode 0", place_poses, setup, poses)


def test_a_car_that_drives_alone_meets_nobody(oval, setup):
    """Wherever the poses put the other one; but its own wall counts."""
    setup = replace(setup, planners=(LATTICE,), vehicles=())
    state = place_poses(setup, poses_at(oval, (3.0, 0.0), (3.1, 0.0))[:, :1])
    assert not state.crashed.any()
    assert state.cars[0, 0, [X, Y]] == pytest.approx(oval.to_cartesian((3.0, 0.0))[:2])
    with pytest.raises(InputError, match="episode 0"):
        place_poses(setup, poses_at(oval, (3.0, 1.1), (7.0, 0.0))[:, :1])


def test_cars_start_where_the_options_say(coarse_oval):
    env = DriveEnv(track=coarse_oval, opponent="lattice")
    env.reset(seed=0, options={"start": (5.0, 1)})
    races = env.batch.state
    assert (races.frenet[0, 0, 0] - races.progress[0, 0]) % env.track.length == pytest.approx(
        5.0, abs=0.05
    )
    poses = np.array([[*env.track.to_cartesian([[s, 0.0]])[0]] for s in (10.0, 6.0)])
    env.reset(seed=0, options={"poses": np.column_stack([poses, [3.0, 2.0]])})
    np.testing.assert_allclose(env.batch.state.cars[0][:, [0, 1]], poses[:, :2])
    np.testing.assert_allclose(env.batch.state.cars[0][:, 3], [3.0, 2.0])
    assert env.batch.info(0)["lead"] == pytest.approx(4.0, abs=0.1)
    assert env.step([0.0, -1.0])[1] > 0.0
