import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from refusal import refused

from pcs_racing_agents.policies import indicators

TWO_TO_FOUR = st.integers(2, 4)


def whole_points(most: int = 12, axes=TWO_TO_FOUR):
    """Points on a grid of whole numbers, so that equal ones and equal coordinates are common."""
    return axes.flatmap(
        lambda g: hnp.arrays(
            np.float64, st.tuples(st.integers(0, most), st.just(g)), elements=st.integers(-2, 6)
        )
    )


def counted(points, reference: float, size: int = 6) -> int:
    """Volume above the reference that is dominated, by counting the unit cells of whole numbers."""
    axes = points.shape[1]
    cells = np.stack(
        np.meshgrid(*[np.arange(reference, size)] * axes, indexing="ij"), axis=-1
    ).reshape(-1, axes)
    return (
        int(np.sum((points[:, None] >= cells + 1.0).all(axis=-1).any(axis=0))) if len(points) else 0
    )


def beaten_by_definition(points, duplicates: bool):
    mask = []
    for i, a in enumerate(points):
        beaten = any((b >= a).all() and (b > a).any() for b in points)
        mask.append(not beaten and (duplicates or not any((b == a).all() for b in points[:i])))
    return mask


@given(whole_points(), st.booleans())
def test_non_dominated_points_are_those_of_the_definition(points, duplicates):
    assert indicators.non_dominated(points, duplicates=duplicates).tolist() == beaten_by_definition(
        points, duplicates
    )


@given(whole_points(most=8, axes=st.integers(2, 3)), st.sampled_from([-2.0, -1.0, 0.0]))
def test_hypervolume_is_the_number_of_cells_below_the_points(points, reference):
    assert indicators.hypervolume(points, reference) == pytest.approx(
        counted(points, reference), abs=1e-9
    )


@given(whole_points(most=8, axes=st.integers(2, 3)))
def test_a_contribution_is_what_the_front_loses_without_the_point(points):
    kept = indicators.non_dominated(points)
    front = points[kept]
    total = indicators.hypervolume(front, -3.0)
    without = np.array(
        [indicators.hypervolume(np.delete(front, i, axis=0), -3.0) for i in range(len(front))]
    )
    found = indicators.contributions(points, -3.0)
    np.testing.assert_allclose(found[kept], total - without, atol=1e-9)
    assert (found[~kept] == 0.0).all()


@given(whole_points(axes=st.just(3)), hnp.arrays(np.float64, (5, 3), elements=st.floats(-3.0, 7.0)))
def test_a_point_improves_a_front_if_and_only_if_it_exceeds_a_corner(front, points):
    corners = indicators.search_corners(front, [-1.0] * 3)
    exceeds = (points[:, None] > corners).all(axis=-1).any(axis=1)
    improves = (points > -1.0).all(axis=-1) & ~(front[None] >= points[:, None]).all(axis=-1).any(
        axis=1
    )
    np.testing.assert_array_equal(exceeds, improves)


@given(whole_points(axes=st.just(2)))
def test_corners_of_two_axes_are_those_of_the_general_rule(front):
    # A third axis on which all points are alike turns the staircase into a general front.
    flat = indicators.search_corners(front, [-1.0, -1.0])
    lifted = indicators.search_corners(
        np.column_stack([front, np.full(len(front), 9.0)]), [-1.0] * 3
    )
    kept = lifted[lifted[:, 2] == -1.0][:, :2]
    assert sorted(map(tuple, flat)) == sorted(map(tuple, kept))


@given(whole_points(axes=st.integers(2, 3)), st.integers(0, 2**32 - 1))
def test_uncrowded_improvement_adds_hypervolume_or_says_how_far_that_is(front, seed):
    points = np.random.default_rng(seed).uniform(-4.0, 8.0, (20, front.shape[1]))
    before = indicators.hypervolume(front, -1.0)
    gain = indicators.uncrowded_improvement(points, front, -1.0)
    after = np.array([indicators.hypervolume(np.vstack([front, point]), -1.0) for point in points])
    np.testing.assert_allclose(np.maximum(gain, 0.0), after - before, atol=1e-9)
    np.testing.assert_allclose(indicators.total_hypervolume(points, front, -1.0), after, atol=1e-9)
    # A step of that length up the right axes leads to the border; a shorter one in any direction
    # does not.
    away = indicators.distance_to_improvement(points, front, -1.0)
    np.testing.assert_array_equal(away, np.maximum(-gain, 0.0))
    step = np.random.default_rng(seed + 1).standard_normal(points.shape)
    step *= 0.999 * away[:, None] / np.linalg.norm(step, axis=1, keepdims=True)
    assert (indicators.uncrowded_improvement(points + step, front, -1.0)[away > 1e-9] <= 0.0).all()
    corners = indicators.search_corners(front, np.full(front.shape[1], -1.0))
    border = np.maximum(points[:, None], corners[None])
    np.testing.assert_allclose(
        np.linalg.norm(border - points[:, None], axis=-1).min(axis=1), away, atol=1e-12
    )


def test_impossible_points_are_named():
    for call, words in [
        (lambda: indicators.hypervolume([[0.0, np.nan]], 0.0), "nan in row 0, axis 1"),
        (lambda: indicators.hypervolume([0.0, 1.0], 0.0), r"shape \(2,\)"),
        (lambda: indicators.hypervolume([["a", "b"]], 0.0), "no number"),
        (lambda: indicators.hypervolume([[0.0, 1.0]], [0.0] * 3), "one finite number or 2"),
        (lambda: indicators.uncrowded_improvement([[0.0, 1.0]], [[0.0] * 3], 0.0), "has 3 axes"),
    ]:
        refused(words, call)
