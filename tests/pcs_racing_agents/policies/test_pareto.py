import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from refusal import refused

from pcs_racing_agents.policies import pareto

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


def beats(one, other) -> bool:
    return all(one >= other) and any(one > other)


@given(whole_points())
def test_fronts_and_layers_follow_from_the_definition(points):
    layers, left, depth = np.full(len(points), -1), list(range(len(points))), 0
    while left:
        first = [i for i in left if not any(beats(points[j], points[i]) for j in left)]
        layers[first], left, depth = depth, [i for i in left if i not in first], depth + 1
    np.testing.assert_array_equal(pareto.front_layers(points), layers)
    first = [not (points[:i] == points[i]).all(axis=1).any() for i in range(len(points))]
    expected = (layers == 0) & np.array(first, bool)
    np.testing.assert_array_equal(pareto.non_dominated(points), expected)


@given(whole_points(most=8, axes=st.integers(2, 3)), st.sampled_from([-2.0, -1.0, 0.0]))
def test_hypervolume_is_the_number_of_cells_below_the_points(points, reference):
    assert pareto.hypervolume(points, reference) == pytest.approx(
        counted(points, reference), abs=1e-9
    )


def test_a_hypervolume_beyond_all_numbers_is_refused():
    for call in (pareto.hypervolume, pareto.contributions, pareto.Scale.of):
        refused("points hold 1e.200, whose hypervolume", call, np.full((1, 2), 1e200))
        refused("points hold nan", call, np.full((1, 2), np.nan))


@given(whole_points(most=8, axes=st.integers(2, 3)))
def test_a_contribution_is_what_the_front_loses_without_the_point(points):
    front = points[pareto.non_dominated(points)]
    total = pareto.hypervolume(front, -3.0)
    without = [
        total - pareto.hypervolume(np.delete(front, i, axis=0), -3.0) for i in range(len(front))
    ]
    np.testing.assert_allclose(pareto.contributions(front, -3.0), without, atol=1e-9)


@given(whole_points(axes=st.integers(2, 3)), st.integers(0, 2**32 - 1))
def test_uncrowded_improvement_adds_hypervolume_or_says_how_far_that_is(front, seed):
    points = np.random.default_rng(seed).uniform(-4.0, 8.0, (20, front.shape[1]))
    before = pareto.hypervolume(front, -1.0)
    gain = pareto.uncrowded_improvement(points, front, -1.0)
    after = np.array([pareto.hypervolume(np.vstack([front, point]), -1.0) for point in points])
    np.testing.assert_allclose(np.maximum(gain, 0.0), after - before, atol=1e-9)
    # A step of that length up the right axes leads to the border; a shorter one in any direction
    # does not.
    away = pareto.distance_to_improvement(points, front, -1.0)
    np.testing.assert_array_equal(away, np.maximum(-gain, 0.0))
    step = np.random.default_rng(seed + 1).standard_normal(points.shape)
    step *= 0.999 * away[:, None] / np.linalg.norm(step, axis=1, keepdims=True)
    assert (pareto.uncrowded_improvement(points + step, front, -1.0)[away > 1e-9] <= 0.0).all()
    corners = pareto.improving_corners(front, -1.0)
    border = np.maximum(points[:, None], corners[None])
    np.testing.assert_allclose(
        np.linalg.norm(border - points[:, None], axis=-1).min(axis=1), away, atol=1e-12
    )


def test_a_scale_is_the_range_of_some_points():
    scale = pareto.Scale.of(np.array([[1.0, 5.0], [3.0, 1.0], [2.0, 2.0]]))
    np.testing.assert_allclose(scale(np.array([[3.0, 3.0], [1.0, 1.0]])), [[1.0, 0.5], [0.0, 0.0]])
    refused("objective 1 is 2", pareto.Scale.of, np.array([[1.0, 2.0], [3.0, 2.0]]))
