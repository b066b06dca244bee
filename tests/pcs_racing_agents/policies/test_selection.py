import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pcs_racing_agents.policies.evaluate import summarise
from pcs_racing_agents.policies.selection import (
    beaten,
    difference_errors,
    front_layers,
    spread_first,
    thin_out,
)

clouds = hnp.arrays(
    np.float64,
    st.tuples(st.integers(1, 12), st.integers(1, 3)),
    elements=st.integers(0, 4).map(float),
)


@given(points=clouds)
def test_each_layer_is_what_no_point_of_it_or_behind_it_beats(points):
    def beats(one, other):
        return all(one >= other) and any(one > other)

    layers, left, depth = np.full(len(points), -1), list(range(len(points))), 0
    while left:
        first = [i for i in left if not any(beats(points[j], points[i]) for j in left)]
        layers[first], left, depth = depth, [i for i in left if i not in first], depth + 1
    np.testing.assert_array_equal(front_layers(points), layers)


def raced(totals, segments=None):
    segments = np.full(totals.shape[:2], 2) if segments is None else segments
    nobody = np.full(totals.shape[:2], -1)
    none = dict.fromkeys(("own_crash", "crashed", "rival"), np.zeros(totals.shape[:2], bool))
    return {"totals": totals, "segments": segments, "winner": nobody, **none}


def test_errors_of_differences_are_those_of_paired_means_also_of_races_cut_short():
    rng = np.random.default_rng(0)
    common = rng.normal(0.0, 10.0, (1, 40, 2))  # luck of the draw, shared by all
    totals = common + rng.normal(0.0, 1.0, (3, 40, 2))
    errors = difference_errors(raced(totals))
    for i in range(3):
        for j in range(3):
            paired = (totals[i] - totals[j]) / 2.0
            np.testing.assert_allclose(
                errors[i, j], paired.std(axis=0, ddof=1) / np.sqrt(40.0), atol=1e-9
            )
    assert (errors[0, 1] < 0.5 * summarise(raced(totals)).spread[0]).all()
    # Over many repetitions, the error that is stated is the one that is made.
    rng = np.random.default_rng(1)
    differences, stated = [], []
    for _ in range(400):
        luck = rng.normal(0.0, 3.0, (1, 60, 1))
        segments = rng.integers(1, 3, (2, 60))
        totals = (luck + rng.normal(1.0, 1.0, (2, 60, 1))) * segments[..., None]
        both = raced(totals, segments)
        coordinates = summarise(both).coordinates
        differences.append(coordinates[0, 0] - coordinates[1, 0])
        stated.append(difference_errors(both)[0, 1, 0])
    assert np.mean(stated) == pytest.approx(np.std(differences), rel=0.1)


def test_a_policy_within_the_error_bars_stays_and_layers_follow_by_hand():
    coordinates = np.array([[1.0, 1.0], [1.2, 1.2], [2.0, 1.05], [0.0, 5.0]])
    errors = np.full((4, 4, 2), 0.15)
    np.testing.assert_array_equal(beaten(coordinates, errors, 0.0), [True, False, False, False])
    np.testing.assert_array_equal(beaten(coordinates, errors, 1.0), [True, False, False, False])
    np.testing.assert_array_equal(beaten(coordinates, errors, 2.0), [False, False, False, False])
    points = np.array([[0.0, 3.0], [3.0, 0.0], [1.0, 1.0], [2.0, 2.0], [0.0, 0.0], [2.0, 2.0]])
    np.testing.assert_array_equal(front_layers(points), [0, 0, 1, 0, 2, 0])


@given(points=clouds)
def test_without_errors_the_front_is_never_beaten(points):
    front = front_layers(points) == 0
    lost = beaten(points, np.zeros((len(points), len(points), points.shape[1])), 0.0)
    assert not (front & lost).any()
    assert not lost.all()


@given(points=clouds, spacing=st.floats(0.0, 3.0), count=st.integers(1, 12))
def test_the_best_come_first(points, spacing, count):
    chosen = spread_first(points, spacing, count)
    layers = front_layers(points)[chosen]
    assert (np.diff(layers) >= 0).all()
    assert layers[0] == 0
    everything = spread_first(points, spacing, len(points))
    np.testing.assert_array_equal(chosen, everything[:count])
    away = np.linalg.norm(points[:, None] - points[everything][None], axis=-1)
    assert (away.min(axis=1) <= spacing).all()  # whatever is left out lies near something better


@given(points=clouds, spacing=st.floats(0.0, 3.0), most=st.integers(2, 12))
def test_chosen_points_keep_their_distance(points, spacing, most):
    chosen = thin_out(points, spacing, most)
    assert 1 <= len(chosen) <= most
    assert sorted(set(chosen.tolist())) == chosen.tolist()
    away = np.linalg.norm(points[chosen][:, None] - points[chosen][None], axis=-1)
    assert (away[~np.eye(len(chosen), dtype=bool)] >= spacing).all()
    best = np.flatnonzero(front_layers(points) == 0)
    assert best[0] in chosen
    # No spacing that is a twentieth narrower would do.
    reach = spacing
    while len(kept := spread_first(points, reach, len(points))) > most:
        reach = max(1.05 * reach, 1e-4)
    assert sorted(kept) == chosen.tolist()
