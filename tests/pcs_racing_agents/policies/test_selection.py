"""Choice of policies: fronts with error bars, and pools with headroom from payoffs that are known
exactly and from a few races.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from refusal import refused

from pcs_racing_agents.policies.evaluate import summarise
from pcs_racing_agents.policies.headroom import headroom, transitive_share
from pcs_racing_agents.policies.pareto import front_layers
from pcs_racing_agents.policies.selection import (
    best_of_each_interval,
    choose_for_headroom,
    choose_pool,
    clearly_beaten,
    denoised,
    difference_errors,
    headroom_notes,
    pool_headroom,
    spread_first,
    thin_out,
)

pytest.importorskip("moocore")

POLICIES, FOLDS = 24, 8
GROUPS = np.array_split(np.arange(POLICIES), 4)

clouds = hnp.arrays(
    np.float64,
    st.tuples(st.integers(1, 12), st.integers(1, 3)),
    elements=st.integers(0, 4).map(float),
)


def raced(totals, segments=None):
    """Races of which only the characteristics are known."""
    shape = totals.shape[:2]
    segments = np.full(shape, 2) if segments is None else segments
    none = dict.fromkeys(("own_crash", "crashed", "rival"), np.zeros(shape, bool))
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


def test_candidates_are_the_best_of_each_interval():
    axis = np.array([0.0, 0.1, 0.2, 0.3, 0.6, 0.9, 1.0])
    score = np.array([0.5, 0.9, 0.1, 0.8, 0.0, 0.3, 0.2])
    # Two intervals: 0, 1, 2, 3 and 4, 5, 6. They take turns, each with its best.
    assert best_of_each_interval(axis, score, 4, 2).tolist() == [1, 3, 5, 6]
    assert best_of_each_interval(axis, score, 7, 2).tolist() == list(range(7))
    assert best_of_each_interval(axis, score, 1, 2).tolist() == [1]


def true_payoffs(seed: int) -> np.ndarray:
    """Payoffs of policies of different strength, half of which also lie on a wheel."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * np.arange(POLICIES) / POLICIES
    radius = np.tile([0.5, 0.0], POLICIES // 2)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    strength = rng.uniform(-0.1, 0.1, POLICIES)
    return np.outer(x, y) - np.outer(y, x) + strength[:, None] - strength[None, :]


def played(truth: np.ndarray, seed: int, races: int) -> np.ndarray:
    """Payoffs as races show them, shape (8, 24, 24)."""
    rng = np.random.default_rng(seed)
    won = np.triu(rng.binomial(races, 0.5 + truth, size=(FOLDS, *truth.shape)) / races - 0.5, 1)
    return won - won.transpose(0, 2, 1)


def test_denoised_payoffs_have_a_smaller_error_and_no_cycles_of_noise():
    truth = true_payoffs(0)
    raw = played(truth, 1, 2)
    error = np.square(denoised(raw) - truth).mean()
    assert error < 0.4 * np.square(raw.mean(axis=0) - truth).mean()
    strength = np.linspace(-0.2, 0.2, POLICIES)
    matrices = [denoised(played(strength[:, None] - strength[None], seed, 2)) for seed in range(10)]
    ratings = [matrix.mean(axis=1) for matrix in matrices]
    cyclic = [m - r[:, None] + r[None] for m, r in zip(matrices, ratings, strict=True)]
    assert sum(np.abs(part).max() < 1e-9 for part in cyclic) >= 7


def test_the_pool_chosen_in_noise_has_true_headroom():
    """Eight races of each pair on two tracks."""
    truths = np.array([true_payoffs(0), true_payoffs(1)])
    folds = np.array([played(truth, seed, 1) for seed, truth in enumerate(truths)])
    pool, notes = choose_for_headroom(folds, 4, 8, 0)
    from_noise = choose_pool(folds.mean(axis=1), GROUPS, 8)
    chosen, noisy, everybody = (
        pool_headroom(truths, policies[None]).mean()
        for policies in (pool, from_noise, np.arange(POLICIES))
    )
    assert chosen > everybody + 0.03
    assert chosen > noisy
    expected = np.array([denoised(part) for part in folds])
    assert pool.tolist() == choose_pool(expected, GROUPS, 8).tolist()
    assert notes == {
        "choice_headroom": pool_headroom(expected, pool[None]).mean(),
        "choice_headroom_of_all_candidates": (
            pool_headroom(expected, np.arange(POLICIES)[None]).mean()
        ),
    }


def test_no_exchange_improves_the_pool_and_its_headroom_follows_from_its_payoffs():
    truth = true_payoffs(3)[None]
    pool = choose_pool(truth, GROUPS, 8)
    best = pool_headroom(truth, pool[None])[0, 0]
    for k, policy in enumerate(pool):
        for other in np.setdiff1d(GROUPS[policy // 6], pool):
            exchanged = pool.copy()
            exchanged[k] = other
            assert pool_headroom(truth, exchanged[None])[0, 0] <= best + 1e-12
    part = truth[0][np.ix_([0, 8, 16], [0, 8, 16])]
    expected = part.max(axis=0).mean() - part.mean(axis=1).max()
    np.testing.assert_allclose(pool_headroom(truth, np.array([[0, 8, 16]])), [[expected]])
    groups = [np.arange(5), np.array([5])]
    refused("group 1 holds 1 policies", choose_pool, np.zeros((1, 6, 6)), groups, 4)


@pytest.mark.parametrize(("count", "taken"), [(8, [2, 2, 2, 2]), (6, [2, 1, 2, 1])])
def test_every_group_gives_its_share(count, taken):
    pool = choose_pool(true_payoffs(0)[None], GROUPS, count)
    assert [np.isin(group, pool).sum() for group in GROUPS] == taken
    assert len(set(pool.tolist())) == count


def test_headroom_is_reported_for_each_track_for_the_tracks_of_the_choice_and_elsewhere():
    rng = np.random.default_rng(0)
    half = rng.uniform(-0.25, 0.25, (16, 4, 4))
    strength = 0.1 * np.arange(4.0)
    here = 0.2 * (half - np.swapaxes(half, -1, -2)) + strength[:, None] - strength
    there = np.zeros((16, 4, 4))  # no share is transitive
    found = headroom(here)
    assert headroom_notes({"Pipkin": here, "Tarnfjord": there}, ("Pipkin",)) == {
        "headroom": found.value,
        "headroom_low": found.low,
        "transitive_share": transitive_share(here),
        "headroom_elsewhere": 0.0,
        "headroom_low_elsewhere": 0.0,
        "transitive_share_elsewhere": "unknown",
        "headroom_Pipkin": f"{found.value:+.3f} +- {found.opponents_error:.3f}",
        "headroom_Tarnfjord": "+0.000 +- 0.000",
    }
    alone = headroom_notes({"Pipkin": here}, ("Pipkin",))
    assert list(alone) == ["headroom", "headroom_low", "transitive_share", "headroom_Pipkin"]
