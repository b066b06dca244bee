"""What a search knows: front and scale against the definitions, one point after the other."""

from dataclasses import replace

import numpy as np
import pytest

from pcs_racing_agents.policies.pareto_archive import ParetoArchive


def known(seed=0, count=30, axes=2):
    """Random points, some of them infeasible, some no members of the archive, two equal."""
    rng = np.random.default_rng(seed)
    objectives = rng.normal(size=(count, axes)).round(1)
    objectives[5] = objectives[4]
    violation, member = rng.normal(-0.5, 0.6, count), rng.random(count) < 0.8
    return ParetoArchive.empty(3).joined(rng.random((count, 3)), objectives, violation, member)


def beats(one, other):
    return (one >= other).all() and (one > other).any()


@pytest.mark.parametrize("seed", range(5))
def test_the_front_is_what_no_other_feasible_member_beats_and_the_first_of_equals(seed):
    explored = known(seed, axes=2 + seed % 2)
    rows = [i for i in range(len(explored)) if explored.member[i] and explored.violation[i] <= 0.0]
    values = explored.objectives
    front = [
        i
        for i in rows
        if not any(
            beats(values[j], values[i]) or (j < i and (values[j] == values[i]).all()) for j in rows
        )
    ]
    assert explored.front.tolist() == front
    assert 0 < len(front) < len(rows) < len(explored)


def test_points_are_added_as_members_unless_stated():
    one = ParetoArchive.empty(2).joined(
        np.array([[0.1, 0.2]]), np.array([[1.0, 2.0, 3.0]]), np.array([-1.0])
    )
    assert len(one) == 1
    assert (one.member.tolist(), one.front.tolist()) == ([True], [0])
    two = one.joined(
        np.array([[0.3, 0.4]]), np.array([[9.0, 9.0, 9.0]]), np.array([0.0]), np.array([False])
    )
    assert two.parameters.tolist() == [[0.1, 0.2], [0.3, 0.4]]
    assert two.objectives.tolist() == [[1.0, 2.0, 3.0], [9.0, 9.0, 9.0]]
    assert two.violation.tolist() == [-1.0, 0.0]
    assert (two.member.tolist(), two.front.tolist()) == ([True, False], [0])
    assert len(one) == 1  # a value


def test_the_scale_runs_from_the_worst_to_the_best_of_the_front_or_of_all_feasible():
    explored = known(1)
    scale = explored.scale()
    front = explored.objectives[explored.front]
    np.testing.assert_array_equal(scale.nadir, front.min(axis=0))
    np.testing.assert_array_equal(scale.ideal, front.max(axis=0))
    np.testing.assert_allclose(
        [scale(front).min(axis=0), scale(front).max(axis=0)], [[0.0, 0.0], [1.0, 1.0]]
    )
    stated = explored.scale(np.array([4.0, 8.0]), np.array([2.0, 0.0]))
    np.testing.assert_allclose(stated(np.array([3.0, 2.0])), [0.5, 0.25])
    objectives, violation = (
        np.array([[5.0, 2.0], [4.0, 2.0], [9.0, 9.0]]),
        np.array([0.0, 0.0, 1.0]),
    )
    single = ParetoArchive.empty(3).joined(np.zeros((3, 3)), objectives, violation)
    assert single.front.tolist() == [0]
    scale = single.scale()
    assert (scale.nadir.tolist(), scale.ideal.tolist()) == ([4.0, 2.0], [5.0, 3.0])
    nothing = replace(single, violation=np.full(3, 9.0)).scale()
    assert (nothing.nadir.tolist(), nothing.ideal.tolist()) == ([0.0, 0.0], [1.0, 1.0])
