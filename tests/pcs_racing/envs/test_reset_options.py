"""The options of a reset that say where the cars stand."""

import numpy as np
import pytest

from pcs_racing import InputError, RaceSetup, load_race_config
from pcs_racing.envs.reset_options import place_poses, poses_option, start_option
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.track.frenet import X, Y


def test_a_start_is_for_all_episodes_or_for_each():
    assert start_option({}, 2) is None
    shared = start_option({"start": (3.0, 1)}, 2)
    assert (shared.s.tolist(), shared.side.tolist()) == ([3.0, 3.0], [1, 1])
    own = start_option({"start": [(3.0, 1), (5.0, 0)]}, 2)
    assert (own.s.tolist(), own.side.tolist()) == ([3.0, 5.0], [1, 0])


@pytest.mark.parametrize("start", [(3.0, 2), (np.nan, 1), (3.0, np.nan), [(3.0, 1)] * 3, 3.0, "here"])
def test_an_impossible_start_is_refused(start):
    with pytest.raises(InputError, match="reset option 'start'"):
        start_option({"start": start}, 2)


def test_poses_have_a_speed_if_one_is_given():
    standing, rolling = [[1.0, 2.0, 0.5], [3.0, 4.0, 0.0]], [[1.0, 2.0, 0.5, 2.0], [3.0, 4.0, 0.0, 0.0]]
    assert poses_option({}, 3) is None
    assert poses_option({"poses": standing}, 3).tolist() == [[[1.0, 2.0, 0.5, 0.0], [3.0, 4.0, 0.0, 0.0]]] * 3
    assert poses_option({"poses": [rolling] * 3}, 3).tolist() == [rolling] * 3


@pytest.mark.parametrize(
    "poses", [[[1.0, 2.0, np.nan], [3.0, 4.0, 0.0]], [[1.0, 2.0, 0.5]], [[1.0, 2.0, 0.0, 99.0]] * 2]
)
def test_impossible_poses_are_refused(poses):
    with pytest.raises(InputError, match="poses"):
        poses_option({"poses": poses}, 1)


@pytest.fixture
def setup(oval):
    return RaceSetup(oval, load_race_config("paper"), (LATTICE, LATTICE))


def poses_at(track, first, second):
    """Poses of both cars, shape (1, 2, 4), from (s, d)."""
    return np.array([[[*track.to_cartesian(place), 0.0] for place in (first, second)]])


def test_progress_is_counted_from_the_car_in_front(oval, setup):
    state = place_poses(setup, poses_at(oval, (3.0, 0.2), (7.0, -0.2)), alone=False)
    assert state.progress[0] == pytest.approx([-4.0, 0.0], abs=0.01)
    assert state.frenet[0] == pytest.approx(np.array([[3.0, 0.2], [7.0, -0.2]]), abs=0.01)


def test_cars_may_not_stand_in_a_wall_or_in_each_other(oval, setup):
    inside_each_other, in_a_wall = poses_at(oval, (3.0, 0.0), (3.1, 0.0)), poses_at(oval, (7.0, 0.0), (3.0, 1.1))
    for poses in (inside_each_other, in_a_wall):
        with pytest.raises(InputError, match="episode 0"):
            place_poses(setup, poses, alone=False)


def test_a_car_that_drives_alone_meets_nobody(oval, setup):
    """Wherever the poses put the other one; but its own wall counts."""
    state = place_poses(setup, poses_at(oval, (3.0, 0.0), (3.1, 0.0)), alone=True)
    assert not state.crashed.any()
    assert state.cars[0, 0, [X, Y]] == pytest.approx(oval.to_cartesian((3.0, 0.0))[:2])
    with pytest.raises(InputError, match="episode 0"):
        place_poses(setup, poses_at(oval, (3.0, 1.1), (7.0, 0.0)), alone=True)
