"""Estimators on simulated tournaments with known effects, and against other people's formulas.

The simulations are seeded; their bands are at least three standard errors wide.
docs/reports/statistics.md has the full study.
"""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, strategies as st
from refusal import refused
from scipy import stats

from pcs_racing_agents.base.statistics import (
    clustered_mean,
    compare,
    holm,
    match_units,
    t_interval,
)

EGOS, OPPONENTS, RACES = 12, 12, 3
EGO, OPPONENT, LINE = (index.ravel() for index in np.indices((EGOS, OPPONENTS, RACES)))
CELL = EGO * OPPONENTS + OPPONENT


def differences(rng, *, ego=0.0, opponent=0.0, cell=0.0, line=0.0, mean=0.0):
    """Differences of two arms; the arguments are the standard deviations of the effects."""
    effects = ego * rng.normal(size=EGOS)[EGO] + opponent * rng.normal(size=OPPONENTS)[OPPONENT]
    effects += cell * rng.normal(size=EGOS * OPPONENTS)[CELL] + line * rng.normal(size=RACES)[LINE]
    return mean + effects + 0.4 * rng.normal(size=len(EGO))


def arms(rng, shift=0.0):
    """Scores of two arms that win and lose the same races; their chances vary with egos and
    opponents.
    """
    race, scores = rng.normal(size=len(EGO)), []
    for mean in (shift, 0.0):
        effects = 0.3 * rng.normal(size=EGOS)[EGO] + 0.3 * rng.normal(size=OPPONENTS)[OPPONENT]
        scores.append((mean + effects + race > 0.0).astype(float))
    return scores


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"ego": 0.2},
        {"opponent": 0.2},
        {"ego": 0.1, "opponent": 0.1},
        {"ego": 0.1, "opponent": 0.1, "cell": 0.3},
    ],
    ids=["none", "ego", "opponent", "crossed", "pairs"],
)
def test_the_clustered_interval_covers_whatever_differs(effects):
    rng = np.random.default_rng(11)
    estimates = [
        clustered_mean(differences(rng, mean=0.1, **effects), EGO, OPPONENT) for _ in range(600)
    ]
    covered = np.mean([e.low <= 0.1 <= e.high for e in estimates])
    assert 0.92 <= covered <= (0.99 if not effects else 0.975)


def slow_variance(x, *kinds):
    """Cameron, Gelbach and Miller, one sum after the other."""
    residual, terms = [value - sum(x) / len(x) for value in x], {}
    for selected in product((0, 1), repeat=len(kinds)):
        if any(selected):
            sums = {}
            for i, value in enumerate(residual):
                key = tuple(kind[i] for kind, used in zip(kinds, selected, strict=True) if used)
                sums[key] = sums.get(key, 0.0) + value
            total = sum(s**2 for s in sums.values()) / len(x) ** 2
            terms[selected] = total * len(sums) / (len(sums) - 1)
    total = sum(term if sum(selected) % 2 else -term for selected, term in terms.items())
    return max(total, *terms.values())


def test_the_variance_is_the_formula_where_races_are_missing():
    rng = np.random.default_rng(5)
    keep = rng.random(len(EGO)) < 0.4
    x, kinds = (
        differences(rng, ego=0.3, opponent=0.2)[keep],
        (EGO[keep], OPPONENT[keep], LINE[keep]),
    )
    for number in (1, 2, 3):
        estimate = clustered_mean(x, *kinds[:number])
        assert estimate.se**2 == pytest.approx(slow_variance(x, *kinds[:number]), rel=1e-12)
        assert estimate.clusters == (EGOS, OPPONENTS, RACES)[:number]
    two_way = clustered_mean(x, *kinds[:2])
    reach = stats.t.ppf(0.975, EGOS - 1) * two_way.se
    assert (two_way.low, two_way.high) == pytest.approx((x.mean() - reach, x.mean() + reach))


def slow_pool_variance(x, ego, opponent):
    """Races that share a policy in whichever role, each pair once: sums over policies less those
    over pairs of them.
    """
    residual = [value - sum(x) / len(x) for value in x]
    policies, pairs = {}, {}
    for value, first, second in zip(residual, ego, opponent, strict=True):
        for policy in {first, second}:
            policies[policy] = policies.get(policy, 0.0) + value
        if first != second:
            pair = frozenset((first, second))
            pairs[pair] = pairs.get(pair, 0.0) + value
    total = 0.0
    for sums, sign in ((policies, 1.0), (pairs, -1.0)):
        total += sign * sum(s**2 for s in sums.values()) * len(sums) / (len(sums) - 1)
    return total / len(x) ** 2


def test_the_variance_of_a_pool_corrects_each_term_by_its_clusters_start_lines_among_them():
    """With few policies G / (G - 1) matters; races of a policy against itself count, too."""
    rng = np.random.default_rng(18)
    for _ in range(20):
        ego, opponent = rng.integers(0, 6, (2, 40))
        policy = rng.normal(size=6)
        x = policy[ego] + policy[opponent] + 0.3 * rng.normal(size=40)
        expected = max(slow_pool_variance(x, ego, opponent), slow_variance(x, ego, opponent))
        assert slow_pool_variance(x, ego, opponent) > 0.0
        assert clustered_mean(x, ego, opponent, same_pool=True).se ** 2 == pytest.approx(
            expected, rel=1e-9
        )


def test_a_negative_variance_is_no_certainty_and_no_difference_no_evidence():
    """On a chess board the sums of rows and columns vanish: the two-way formula alone gives less
    than nothing.
    """
    board = 0.01 + np.where((EGO + OPPONENT) % 2 == 0, 0.5, -0.5)
    estimate = clustered_mean(board, EGO, OPPONENT)
    assert estimate.se >= 0.99 * 0.5 / np.sqrt(EGOS * OPPONENTS)
    assert estimate.p > 0.5
    scores = arms(np.random.default_rng(0))[0]
    result = compare(scores, scores, EGO, OPPONENT)
    assert (result.difference, result.low, result.high) == (0.0, 0.0, 0.0)
    assert (result.p_clustered, result.p_paired_t, result.cohen_d) == (
        pytest.approx(1.0),
        pytest.approx(1.0),
        0.0,
    )
    result = compare([0.7, 0.6, 0.9], [0.6, 0.5, 0.8], [0, 1, 2], [0, 1, 1])
    assert result.p_paired_t == 0.0
    assert result.cohen_d == np.inf


@given(st.integers(0, 2**32 - 1))
def test_symmetries_of_a_comparison(seed):
    """Other names of clusters and another order of the races change nothing; swapping the arms
    changes the sign.
    """
    rng = np.random.default_rng(seed)
    a, b = arms(rng, 0.2)
    result = compare(a, b, EGO, OPPONENT)
    order = rng.permutation(len(a))
    names = np.array([f"policy {k}" for k in rng.permutation(EGOS)])
    again = compare(a[order], b[order], names[EGO[order]], -2.5 * OPPONENT[order])
    swapped = compare(b, a, EGO, OPPONENT)
    for name in ("difference", "low", "high", "p_clustered", "p_paired_t", "cohen_d"):
        assert getattr(again, name) == pytest.approx(getattr(result, name), rel=1e-9, abs=1e-12)
    assert (swapped.low, swapped.high) == pytest.approx((-result.high, -result.low))
    assert (swapped.mean_a, swapped.cohen_d) == pytest.approx((result.mean_b, -result.cohen_d))
    assert result.low <= result.difference <= result.high
    assert (result.units, result.egos, result.opponents, result.df) == (
        len(a),
        EGOS,
        OPPONENTS,
        EGOS - 1,
    )


def test_a_comparison_with_one_opponent_has_clusters_of_egos_alone():
    a, b, ego = [1.0, 0.0, 1.0, 1.0], [0.0, 0.0, 1.0, 0.0], [0, 0, 1, 1]
    result = compare(a, b, ego, ["o"] * 4)
    alone = clustered_mean(np.subtract(a, b), ego)
    assert (result.difference, result.low, result.high) == (alone.mean, alone.low, alone.high)
    assert result.opponents == 1


def test_the_paired_t_test_is_that_of_the_means_of_the_egos():
    """Against scipy's own test (the code uses only its distribution)."""
    rng = np.random.default_rng(6)
    a, b = rng.random((2, 400))
    result = compare(a, b, np.repeat(np.arange(20), 20), np.tile(np.arange(20), 20))
    expected = stats.ttest_rel(a.reshape(20, 20).mean(axis=1), b.reshape(20, 20).mean(axis=1))
    assert result.p_paired_t == pytest.approx(expected.pvalue)
    assert result.cohen_d == pytest.approx(expected.statistic / np.sqrt(20))


def test_the_interval_and_the_p_values_are_those_of_student_and_holm():
    for t in (0.3, 2.0, 6.0):
        low, high, p = t_interval(t, 1.0, 4)
        assert p == pytest.approx(2.0 * stats.t.sf(t, 4))
        assert (low, high) == pytest.approx(stats.t.interval(0.95, 4, loc=t))
    rng = np.random.default_rng(10)
    for p in (rng.random(6) ** 3 for _ in range(50)):
        for alpha in (0.01, 0.05, 0.2):
            rejected = np.zeros(6, bool)
            for step, k in enumerate(np.argsort(p)):
                if p[k] > alpha / (6 - step):
                    break
                rejected[k] = True
            assert ((holm(p) <= alpha) == rejected).all()
    assert holm([0.01, 0.04, 0.03, 0.9]) == pytest.approx([0.04, 0.09, 0.09, 0.9])
    assert holm([0.6, 0.7]) == pytest.approx([1.0, 1.0])


def test_units_are_matched_by_what_they_are():
    a = [("x", 1), ("x", 2), ("y", 1)]
    b = [("y", 1), ("x", 1), ("x", 2)]
    assert [b[i] for i in match_units(a, b)] == a
    refused(r"arm b .*\('y', 1\)", match_units, a, b[1:])
    refused(r"arm a .*\('z', 1\)", match_units, a, [*b, ("z", 1)])
    refused(r"arm b .*\('x', 1\)", match_units, a, [*b, ("x", 1)])


TWO = [0, 0, 1, 1]
ONES = [1.0, 0.0, 1.0, 1.0]


def test_bad_input():
    for call, message in [
        (lambda: compare(ONES, ONES[1:], TWO, TWO), "a has 4 scores and b 3"),
        (lambda: compare([1, 0, np.nan, 0], ONES, TWO, TWO), "a holds nan"),
        (lambda: compare(ONES, ONES, [0, 0, 0, 0], TWO), r"ego labels are \[0\]"),
        (lambda: compare(ONES, ONES, TWO[1:], TWO), r"ego labels have shape \(3,\)"),
        (lambda: compare(ONES, ONES, TWO, TWO, start=[0, 0, 0, np.nan]), "start labels must"),
        (lambda: compare(ONES, ONES, [None, 1, 2, 3], TWO), r"ego labels .*object"),
        (lambda: compare([], [], [], []), r"ego labels are \[\]"),
        (lambda: compare(["win"] * 4, ONES, TWO, TWO), "a is .*must hold numbers"),
        (lambda: clustered_mean(ONES), "cluster labels"),
        (lambda: clustered_mean(ONES, TWO, same_pool=True), r"^same_pool"),
        (lambda: clustered_mean(ONES, TWO, TWO, [0, 0, 0, 0]), r"start labels are \[0\]"),
    ]:
        refused(message, call)
