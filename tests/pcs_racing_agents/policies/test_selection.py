"""Choice of policies: fronts with error bars, and policies far from each other."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from pcs_racing_agents.policies.evaluate import summarise
from pcs_racing_agents.policies.pareto import front_layers
from pcs_racing_agents.policies.selection import (
    clearly_beaten,
    difference_errors,
    spread_first,
    spread_out,
    thin_out,
)

pytest.importorskip("moocore")

clouds = hnp.arrays(
    np.float64,
    st.tuples(st.integers(1, 12), st.integers(1, 3)),
    elements=st.integers(0, 4).map(float),
)


def raced(totals, segments=None):
    """Races with known characteristics only."""
    shape = totals.shape[:2]
    segments = np.full(shape, 2) if segments is None else segments
    none = dict.fromkeys(("own_crash", "crashed"), np.zeros(shape, bool))
    return {"totals": totals, "segments": segments, "winner": np.full(shape, -1), **none}


def test_errors_of_differences_are_the_errors_of_paired_means_also_of_races_cut_short():
    rng = np.random.default_rng(0)
    common = rng.normal(0.0, 10.0, (1, 40, 2))  # luck of the draw, shared by all
    totals = common + rng.normal(0.0, 1.0, (3, 40, 2))
    errors = difference_errors(raced(totals))
    paired = (totals[:, None] - totals[None]) / 2.0
    np.testing.assert_allclose(errors, paired.std(axis=2, ddof=1) / np.sqrt(40.0), atol=1e-9)
    # Over many repetitions, the stated error is the error.
    differences, stated = [], []
    for _ in range(400):
        luck = rng.normal(0.0, 3.0, (1, 60, 1))
        segments = rng.integers(1, 3, (2, 60))
        both = raced((luck + rng.normal(1.0, 1.0, (2, 60, 1))) * segments[..., None], segments)
        coordinates = summarise(both).coordinates
        differences.append(coordinates[0, 0] - coordinates[1, 0])
        stated.append(difference_errors(both)[0, 1, 0])
    assert np.mean(stated) == pytest.approx(np.std(differences), rel=0.1)


def test_a_policy_within_the_error_bars_is_not_clearly_beaten():
    # Coordinates 1, 1.2 and 2, with an error of .15 of the first difference.
    noise = np.array([[0.1, -0.1] * 8, [-0.1, 0.1] * 8, [0.0] * 16])
    unit = noise / difference_errors(raced(noise[..., None]))[0, 1, 0] * 0.15
    totals = np.stack([unit + 2.0 * np.array([[1.0], [1.2], [2.0]])] * 2, axis=-1)
    totals[2, :, 1] = 0.0
    races, rows = raced(totals), np.arange(3)
    assert clearly_beaten(races, rows, 0.0).tolist() == [True, False, False]
    assert clearly_beaten(races, rows, 1.0).tolist() == [True, False, False]
    assert clearly_beaten(races, rows, 2.0).tolist() == [False, False, False]
    assert clearly_beaten(races, rows[[0, 2]], 0.0).tolist() == [False, False]


@given(points=clouds, spacing=st.floats(0.0, 3.0), count=st.integers(1, 12))
def test_the_best_come_first(points, spacing, count):
    chosen = spread_first(points, spacing, count)
    layers = front_layers(points)[chosen]
    assert (np.diff(layers) >= 0).all()
    assert layers[0] == 0
    everything = spread_first(points, spacing, len(points))
    np.testing.assert_array_equal(chosen, everything[:count])
    away = np.linalg.norm(points[:, None] - points[everything][None], axis=-1)
    assert (away.min(axis=1) <= spacing).all()  # a point left out lies near a better one


@given(points=clouds, spacing=st.floats(0.01, 3.0), most=st.integers(2, 12))
def test_chosen_points_keep_their_distance(points, spacing, most):
    chosen = thin_out(points, spacing, most)
    assert 1 <= len(chosen) <= most
    away = np.linalg.norm(points[chosen][:, None] - points[chosen][None], axis=-1)
    assert (away[~np.eye(len(chosen), dtype=bool)] >= spacing).all()
    # No spacing that is a twentieth narrower would do.
    reach = spacing
    while len(kept := spread_first(points, reach, len(points))) > most:
        reach *= 1.05
    assert sorted(kept) == chosen.tolist()


@given(clouds, st.integers(1, 12), st.integers(1, 3))
def test_points_far_apart_are_chosen_one_by_one(points, count, first):
    first = min(first, len(points))
    chosen = spread_out(points, count, first).tolist()
    assert chosen[:first] == list(range(first))
    assert len(set(chosen)) == len(chosen) <= max(count, first)
    for k in range(first, len(chosen)):
        away = np.square(points[:, None] - points[chosen[:k]]).sum(axis=-1).min(axis=1)
        assert away[chosen[k]] == away.max() > 0.0
    if len(chosen) < count:  # all other points lie on chosen ones
        assert all((points[chosen] == point).all(axis=1).any() for point in points)
