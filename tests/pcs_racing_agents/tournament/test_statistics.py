"""Estimators on simulated tournaments with known effects, and against other people's formulas.

The simulations are seeded; their bands are at least three standard errors wide. benchmarks/statistics_coverage.py runs
the full study.
"""

import re
import sys
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from repository import REPOSITORY
from scipy import stats

from pcs_racing import InputError
from pcs_racing_agents.tournament.statistics import (
    VarianceComponents,
    adaptivity_gain,
    bootstrap_interval,
    clustered_mean,
    compare,
    detectable_effect,
    effect_sizes,
    holm,
    match_units,
    paired_t,
    power,
    score,
    sign_flip_p,
    variance_components,
    wilson,
)

PAGE = REPOSITORY / "docs" / "statistics.md"
EGOS, OPPONENTS, RACES = 12, 12, 3
EGO, OPPONENT, LINE = (index.ravel() for index in np.indices((EGOS, OPPONENTS, RACES)))
CELL = EGO * OPPONENTS + OPPONENT


def differences(rng, *, ego=0.0, opponent=0.0, cell=0.0, line=0.0, mean=0.0):
    """Differences of two arms; the arguments are the standard deviations of the effects."""
    effects = ego * rng.normal(size=EGOS)[EGO] + opponent * rng.normal(size=OPPONENTS)[OPPONENT]
    effects += cell * rng.normal(size=EGOS * OPPONENTS)[CELL] + line * rng.normal(size=RACES)[LINE]
    return mean + effects + 0.4 * rng.normal(size=len(EGO))


def arms(rng, shift=0.0):
    """Scores of two arms that win and lose the same races; their chances vary with egos and opponents."""
    race, scores = rng.normal(size=len(EGO)), []
    for mean in (shift, 0.0):
        effects = 0.3 * rng.normal(size=EGOS)[EGO] + 0.3 * rng.normal(size=OPPONENTS)[OPPONENT]
        scores.append((mean + effects + race > 0.0).astype(float))
    return scores


# The interval


@pytest.mark.parametrize(
    "effects",
    [{}, {"ego": 0.2}, {"opponent": 0.2}, {"ego": 0.1, "opponent": 0.1}, {"ego": 0.1, "opponent": 0.1, "cell": 0.3}],
    ids=["none", "ego", "opponent", "crossed", "pairs"],
)
def test_the_clustered_interval_covers_whatever_differs(effects):
    rng = np.random.default_rng(11)
    estimates = [clustered_mean(differences(rng, mean=0.1, **effects), EGO, OPPONENT) for _ in range(600)]
    covered = np.mean([e.low <= 0.1 <= e.high for e in estimates])
    assert 0.92 <= covered <= (0.99 if not effects else 0.975)


def test_false_positives_where_egos_and_opponents_differ():
    """The paper's test takes the opponents as given, so it rejects far too often; the clustered one does not."""
    rng = np.random.default_rng(2)
    zeros = np.zeros(len(EGO))
    results = [compare(differences(rng, ego=0.1, opponent=0.1), zeros, EGO, OPPONENT) for _ in range(600)]
    assert 0.025 <= np.mean([r.p_clustered < 0.05 for r in results]) <= 0.08
    assert np.mean([r.p_paired_t < 0.05 for r in results]) >= 0.1


def test_wins_and_losses_with_a_known_effect():
    rng = np.random.default_rng(3)
    truth = stats.norm.cdf(0.3 / np.sqrt(1.0 + 2 * 0.3**2)) - 0.5
    results = [compare(*arms(rng, 0.3), EGO, OPPONENT) for _ in range(400)]
    assert np.mean([r.difference for r in results]) == pytest.approx(truth, abs=0.012)
    assert 0.915 <= np.mean([r.low <= truth <= r.high for r in results]) <= 0.985


def test_start_lines_that_all_pairs_share_are_a_third_kind_of_cluster():
    rng = np.random.default_rng(4)
    draws = [differences(rng, ego=0.05, opponent=0.05, line=0.2) for _ in range(300)]
    zeros = np.zeros(len(EGO))
    two = np.mean([compare(d, zeros, EGO, OPPONENT).p_clustered < 0.05 for d in draws])
    three = [compare(d, zeros, EGO, OPPONENT, start=LINE) for d in draws]
    assert two > 0.3
    assert np.mean([r.p_clustered < 0.05 for r in three]) < 0.1
    assert {r.df for r in three} == {RACES - 1}


def slow_variance(x, *kinds):
    """Cameron, Gelbach and Miller, one sum after the other."""
    residual, terms = [value - sum(x) / len(x) for value in x], {}
    for chosen in product((0, 1), repeat=len(kinds)):
        if any(chosen):
            sums = {}
            for i, value in enumerate(residual):
                key = tuple(kind[i] for kind, used in zip(kinds, chosen, strict=True) if used)
                sums[key] = sums.get(key, 0.0) + value
            total = sum(s**2 for s in sums.values()) / len(x) ** 2
            terms[chosen] = total * len(sums) / (len(sums) - 1)
    total = sum(term if sum(chosen) % 2 else -term for chosen, term in terms.items())
    return max(total, *terms.values())


def test_the_variance_is_the_formula_where_races_are_missing():
    rng = np.random.default_rng(5)
    keep = rng.random(len(EGO)) < 0.4
    x, kinds = differences(rng, ego=0.3, opponent=0.2)[keep], (EGO[keep], OPPONENT[keep], LINE[keep])
    for number in (1, 2, 3):
        estimate = clustered_mean(x, *kinds[:number])
        assert estimate.se**2 == pytest.approx(slow_variance(x, *kinds[:number]), rel=1e-12)
        assert estimate.clusters == (EGOS, OPPONENTS, RACES)[:number]
    reach = stats.t.ppf(0.995, EGOS - 1) * clustered_mean(x, *kinds[:2]).se
    wide = clustered_mean(x, *kinds[:2], level=0.99)
    assert (wide.low, wide.high) == pytest.approx((x.mean() - reach, x.mean() + reach))


def test_policies_in_both_roles_are_one_cluster():
    """Twelve policies are egos and opponents, and what each brings is the same in both roles."""
    rng = np.random.default_rng(16)
    two, pool = [], []
    for _ in range(400):
        policy = 0.2 * rng.normal(size=EGOS)
        x = differences(rng) + policy[EGO] + policy[OPPONENT]
        two.append(clustered_mean(x, EGO, OPPONENT).p < 0.05)
        pool.append(clustered_mean(x, EGO, OPPONENT, same_pool=True).p < 0.05)
    assert np.mean(two) > 0.15
    assert 0.03 <= np.mean(pool) <= 0.11


def test_the_variance_of_a_pool_is_the_sum_over_races_that_share_a_policy():
    """Against the sum over all pairs of races; the corrections G / (G - 1) are near 1 with hundreds of policies."""
    rng = np.random.default_rng(17)
    policies = rng.normal(size=400)
    ego, opponent, line = rng.integers(0, 400, 1500), rng.integers(0, 400, 1500), rng.integers(0, 300, 1500)
    x = policies[ego] + policies[opponent] + rng.normal(size=1500)
    e = (x - x.mean()) / 1500
    shared = (ego[:, None] == ego) | (ego[:, None] == opponent)
    shared |= (opponent[:, None] == ego) | (opponent[:, None] == opponent)
    expected = e @ shared @ e
    assert clustered_mean(x, ego, opponent, same_pool=True).se ** 2 == pytest.approx(expected, rel=0.01)
    names = np.char.add("policy ", ego.astype(str)), np.char.add("policy ", opponent.astype(str))
    assert clustered_mean(x, *names, same_pool=True).se ** 2 == pytest.approx(expected, rel=0.01)
    e += 0.5 * rng.normal(size=300)[line] / 1500
    e -= e.mean()
    expected = e @ (shared | (line[:, None] == line)) @ e
    assert clustered_mean(1500 * e, ego, opponent, line, same_pool=True).se ** 2 == pytest.approx(expected, rel=0.01)


def slow_pool_variance(x, ego, opponent):
    """Races that share a policy in whichever role, each pair once: sums over policies less those over pairs of them."""
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


def test_each_term_of_the_variance_of_a_pool_has_the_correction_of_its_own_clusters():
    """With few policies and pairs G / (G - 1) matters; races of a policy against itself count, too."""
    rng = np.random.default_rng(18)
    for _ in range(20):
        ego, opponent = rng.integers(0, 6, (2, 40))
        policy = rng.normal(size=6)
        x = policy[ego] + policy[opponent] + 0.3 * rng.normal(size=40)
        expected = max(slow_pool_variance(x, ego, opponent), slow_variance(x, ego, opponent))
        assert slow_pool_variance(x, ego, opponent) > 0.0
        assert clustered_mean(x, ego, opponent, same_pool=True).se ** 2 == pytest.approx(expected, rel=1e-9)


def test_a_negative_variance_estimate_does_not_become_certainty():
    """On a chess board the sums of rows and columns vanish: the two-way formula alone gives less than nothing."""
    board = 0.01 + np.where((EGO + OPPONENT) % 2 == 0, 0.5, -0.5)
    estimate = clustered_mean(board, EGO, OPPONENT)
    assert estimate.se >= 0.99 * 0.5 / np.sqrt(EGOS * OPPONENTS)
    assert estimate.p > 0.5


def test_identical_arms_are_no_evidence():
    scores = arms(np.random.default_rng(0))[0]
    result = compare(scores, scores, EGO, OPPONENT)
    assert (result.difference, result.low, result.high) == (0.0, 0.0, 0.0)
    assert (result.p_clustered, result.p_paired_t, result.cohen_d) == (pytest.approx(1.0), pytest.approx(1.0), 0.0)


@given(st.integers(0, 2**32 - 1))
def test_symmetries_of_a_comparison(seed):
    """Other names of clusters and another order of the races change nothing; swapping the arms changes the sign."""
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
    assert (result.units, result.egos, result.opponents, result.df) == (len(a), EGOS, OPPONENTS, EGOS - 1)


def test_a_comparison_counts_its_egos_and_its_opponents():
    some = OPPONENT < 5
    result = compare(*(scores[some] for scores in arms(np.random.default_rng(0), 0.2)), EGO[some], OPPONENT[some])
    assert (result.units, result.egos, result.opponents, result.df) == (EGOS * 5 * RACES, EGOS, 5, 4)
    assert (result.level, compare(ONES, [0.0] * 4, TWO, [0, 1, 0, 1], level=0.9).level) == (0.95, 0.9)


def test_comparing_needs_no_scipy(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy", None)
    a, b = arms(np.random.default_rng(0), 0.2)
    assert compare(a, b, EGO, OPPONENT).difference > 0.0


# The other tests


def test_the_paired_t_test_is_that_of_scipy():
    rng = np.random.default_rng(6)
    a, b = rng.random((2, 400))
    ego = np.repeat(np.arange(20), 20)
    result = paired_t(a, b, ego, level=0.9)
    means = a.reshape(20, 20).mean(axis=1), b.reshape(20, 20).mean(axis=1)
    expected = stats.ttest_rel(*means)
    interval = expected.confidence_interval(0.9)
    assert result.df == 19
    assert result.p == pytest.approx(expected.pvalue)
    assert (result.low, result.high) == pytest.approx((interval.low, interval.high))
    assert result.cohen_d == pytest.approx(expected.statistic / np.sqrt(20))


def test_equal_differences_everywhere_are_certain():
    result = paired_t([0.7, 0.6, 0.9], [0.6, 0.5, 0.8], [0, 1, 2])
    assert result.p == 0.0
    assert result.cohen_d == np.inf


@given(st.lists(st.integers(-4, 4), min_size=2, max_size=9))
def test_sign_flips_count_every_combination(sums):
    flips = [abs(sum(s * x for s, x in zip(signs, sums, strict=True))) for signs in product((-1, 1), repeat=len(sums))]
    expected = np.mean(np.array(flips) >= abs(sum(sums)))
    assert sign_flip_p(0.1 * np.array(sums), np.arange(len(sums))) == expected


def test_sign_flips_of_whole_clusters_keep_their_level():
    rng = np.random.default_rng(7)
    zeros = [sign_flip_p(differences(rng, ego=0.3), EGO) for _ in range(400)]
    assert 0.02 <= np.mean(np.array(zeros) < 0.05) <= 0.085
    races = [sign_flip_p(differences(rng, ego=0.3), np.arange(len(EGO)), rng, flips=99) for _ in range(100)]
    assert np.mean(np.array(races) < 0.05) > 0.2  # flipping single races would not


def test_random_sign_flips_agree_with_all_of_them():
    rng = np.random.default_rng(8)
    x = rng.normal(size=32)
    x += 0.3 - x.mean()
    exact = sign_flip_p(x, np.arange(32))
    # A 33rd ego that always breaks even changes nothing but the method.
    drawn = sign_flip_p(np.append(x, 0.0), np.arange(33), rng, flips=20_000)
    assert 0.02 < exact < 0.5
    assert drawn == pytest.approx(exact, abs=4.0 * np.sqrt(exact / 20_000))


def test_random_sign_flips_go_down_to_one_in_a_hundred_thousand():
    """Forty egos that all gain: of 99,999 random combinations of signs none is as extreme."""
    assert sign_flip_p(np.linspace(1.0, 1.1, 40), np.arange(40), np.random.default_rng(0)) == 1e-5
    assert sign_flip_p(np.linspace(1.0, 1.1, 40), np.arange(40), np.random.default_rng(0), flips=99) == 0.01


def test_the_bootstrap_covers_and_repeats():
    rng = np.random.default_rng(9)
    covered = 0
    for _ in range(300):
        low, high = bootstrap_interval(differences(rng, ego=0.1, opponent=0.1), EGO, OPPONENT, rng, replicates=200)
        covered += low <= 0.0 <= high
    assert 0.88 <= covered / 300 <= 0.99
    x = differences(rng)
    one, two = (bootstrap_interval(x, EGO, OPPONENT, np.random.default_rng(1)) for _ in range(2))
    assert one == two
    wide = bootstrap_interval(x, EGO, OPPONENT, np.random.default_rng(1), level=0.99)
    assert wide[0] < one[0] < x.mean() < one[1] < wide[1]


def test_the_bootstrap_is_owens_pigeonhole_where_races_are_missing():
    """Replicate by replicate: a race counts as often as its ego was drawn times as often as its opponent was."""
    keep = (EGO + OPPONENT) % 3 != 1  # so that the last pair, too, has no race
    x, ego, opponent = differences(np.random.default_rng(3), ego=0.3)[keep], EGO[keep], OPPONENT[keep]
    assert not ((ego == EGOS - 1) & (opponent == OPPONENTS - 1)).any()
    rng, means = np.random.default_rng(1), []
    egos, opponents = (rng.multinomial(n, np.full(n, 1.0 / n), size=100) for n in (EGOS, OPPONENTS))
    for first, second in zip(egos, opponents, strict=True):
        weights = first[ego] * second[opponent]
        means.append((weights @ x) / weights.sum())
    for level in (0.95, 0.8):
        found = bootstrap_interval(x, ego, opponent, np.random.default_rng(1), replicates=100, level=level)
        assert found == pytest.approx(tuple(np.quantile(means, [0.5 - level / 2.0, 0.5 + level / 2.0])))


def test_holm_is_the_step_down_procedure():
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


def test_holm_keeps_the_level_of_the_whole_table():
    tables = np.random.default_rng(0).random((2000, 6))
    assert np.mean([p.min() < 0.05 for p in tables]) > 0.2
    assert np.mean([holm(p).min() < 0.05 for p in tables]) == pytest.approx(0.05, abs=0.015)


# Rates and effects


def test_wilson_is_that_of_scipy():
    for hits, races, level in ((0, 20, 0.95), (1, 20, 0.95), (13, 40, 0.9), (40, 40, 0.99)):
        expected = stats.binomtest(hits, races).proportion_ci(level, method="wilson")
        low, high = wilson(hits, races, level=level)
        assert (low, high) == pytest.approx((expected.low, expected.high), abs=1e-12)
    low, high = wilson([0, 5, 10], 10)
    assert low[0] == 0.0
    assert high[-1] == 1.0
    assert ((low <= [0.0, 0.5, 1.0]) & (high >= [0.0, 0.5, 1.0])).all()


def test_effect_sizes():
    a, b = np.array([1, 1, 1, 0, 1, 1, 0, 1.0]), np.array([0, 1, 0, 0, 1, 0.5, 0, 0.5])
    sizes = effect_sizes(a, b, [0, 0, 1, 1, 2, 2, 3, 3])
    assert sizes.risk_difference == pytest.approx(0.375)
    assert sizes.risk_ratio == pytest.approx(0.75 / 0.375)
    assert sizes.odds_ratio == pytest.approx(3.0 / 0.6)
    by_ego = np.array([0.5, 0.5, 0.25, 0.25])
    assert sizes.cohen_d == pytest.approx(by_ego.mean() / by_ego.std(ddof=1))
    assert effect_sizes(np.ones(4), np.zeros(4), [0, 0, 1, 1])[2:] == (np.inf, np.inf)
    assert np.isnan(effect_sizes(np.zeros(4), np.zeros(4), [0, 0, 1, 1])[2:]).all()


def test_score_counts_a_tie_half_and_a_crash_nothing():
    assert score([True, False, False], [False, True, False]).tolist() == [1.0, 0.5, 0.0]


def test_units_are_matched_by_what_they_are():
    a = [("x", 1), ("x", 2), ("y", 1)]
    b = [("y", 1), ("x", 1), ("x", 2)]
    assert [b[i] for i in match_units(a, b)] == a
    with pytest.raises(InputError, match=r"arm b did not race unit \('y', 1\) \(1 missing\)"):
        match_units(a, b[1:])
    with pytest.raises(InputError, match=r"arm a did not race unit \('z', 1\)"):
        match_units(a, [*b, ("z", 1)])
    with pytest.raises(InputError, match=r"arm b raced unit \('x', 1\) more than once"):
        match_units(a, [*b, ("x", 1)])


# Power


def test_variance_components_come_back():
    rng = np.random.default_rng(12)
    true = VarianceComponents(0.04, 0.01, 0.09, 0.16)
    found = [variance_components(differences(rng, ego=0.2, opponent=0.1, cell=0.3), EGO, OPPONENT) for _ in range(300)]
    assert np.mean(found, axis=0) == pytest.approx(true, rel=0.12)
    once = variance_components(differences(rng, cell=0.3)[LINE == 0], EGO[LINE == 0], OPPONENT[LINE == 0])
    assert once.unit == 0.0
    assert once.cell == pytest.approx(0.25, rel=0.4)
    assert min(variance_components(np.tile([1.0, -1.0], len(EGO) // 2), EGO, OPPONENT)) >= 0.0


@pytest.mark.parametrize("effect", [0.05, 0.1])
def test_power_is_how_often_the_effect_is_found(effect):
    rng = np.random.default_rng(13)
    design = {"egos": EGOS, "opponents": OPPONENTS, "races": RACES}
    expected = power(effect, VarianceComponents(0.01, 0.01, 0.0, 0.16), **design)
    found = [
        clustered_mean(differences(rng, ego=0.1, opponent=0.1, mean=effect), EGO, OPPONENT).p < 0.05 for _ in range(400)
    ]
    assert np.mean(found) == pytest.approx(expected, abs=0.08)


def test_power_is_that_of_a_t_test_whose_variance_the_components_make():
    """Each component divided by how many draws of it there are; scipy's non-central t distribution."""
    components = VarianceComponents(ego=0.04, opponent=0.03, cell=0.5, unit=0.9)
    for egos, opponents, races in ((20, 20, 10), (6, 15, 2), (15, 6, 1)):
        variance = 0.04 / egos + 0.03 / opponents + 0.5 / (egos * opponents) + 0.9 / (egos * opponents * races)
        df, effect = min(egos, opponents) - 1, 0.15
        for level in (0.95, 0.8):
            limit = stats.t.ppf(0.5 + level / 2.0, df)
            shift = effect / np.sqrt(variance)
            expected = stats.nct.sf(limit, df, shift) + stats.nct.cdf(-limit, df, shift)
            found = power(effect, components, egos=egos, opponents=opponents, races=races, level=level)
            assert found == pytest.approx(expected, abs=1e-6)


def test_variance_components_of_a_table_by_hand():
    """Two egos, three opponents, two races each: mean squares between egos, opponents and pairs, and within them."""
    ego, opponent, _ = (index.ravel() for index in np.indices((2, 3, 2)))
    x = np.array([3.0, 5.0, 0.0, 2.0, 7.0, 7.0, 1.0, 1.0, 4.0, 0.0, 2.0, 4.0])
    means = x.reshape(2, 3, 2).mean(axis=2)  # [[4, 1, 7], [1, 2, 3]]
    rows, columns, mean = means.mean(axis=1), means.mean(axis=0), means.mean()
    square_ego = 6.0 * ((rows - mean) ** 2).sum() / 1.0
    square_opponent = 4.0 * ((columns - mean) ** 2).sum() / 2.0
    square_cell = 2.0 * ((means - rows[:, None] - columns + mean) ** 2).sum() / 2.0
    square_unit = ((x.reshape(2, 3, 2) - means[..., None]) ** 2).sum() / 6.0
    expected = VarianceComponents(
        ego=(square_ego - square_cell) / 6.0,
        opponent=(square_opponent - square_cell) / 4.0,
        cell=(square_cell - square_unit) / 2.0,
        unit=square_unit,
    )
    assert min(expected) > 0.0
    assert variance_components(x, ego, opponent) == pytest.approx(expected)


def test_detectable_effect_is_the_effect_of_that_power():
    components = VarianceComponents(0.01, 0.02, 0.03, 0.25)
    effect = detectable_effect(components, egos=20, opponents=30, races=4, wanted=0.9)
    assert power(effect, components, egos=20, opponents=30, races=4) == pytest.approx(0.9)
    assert power(0.0, components) == pytest.approx(0.05)
    assert power(0.01, VarianceComponents(0, 0, 0, 0)) == 1.0


# Adaptivity


def test_the_blind_arm_is_chosen_on_training_races():
    rng = np.random.default_rng(14)
    adaptive, plain = arms(rng, 0.5)
    blind = {"fast": np.ones(len(EGO)), "careful": plain}
    result = adaptivity_gain(adaptive, blind, EGO, OPPONENT, training={"fast": [0.2, 0.4], "careful": [0.5, 0.5]})
    assert result.best_blind == "careful"
    assert result.training == pytest.approx({"fast": 0.3, "careful": 0.5})
    assert result.gain == compare(adaptive, plain, EGO, OPPONENT)
    assert result.over_each["fast"].difference < 0.0 < result.gain.difference


def test_choosing_on_the_test_races_would_hide_the_gain():
    """Ten blind arms alike, an adaptive one 0.05 better: the luckiest blind arm of the test takes half of that."""
    rng = np.random.default_rng(15)
    gains, lucky, covered = [], [], 0
    for _ in range(150):
        blind = {str(k): differences(rng, ego=0.05, opponent=0.05) for k in range(10)}
        training = {name: differences(rng, ego=0.05, opponent=0.05) for name in blind}
        adaptive = differences(rng, ego=0.05, opponent=0.05, mean=0.05)
        result = adaptivity_gain(adaptive, blind, EGO, OPPONENT, training=training)
        gains.append(result.gain.difference)
        lucky.append(min(each.difference for each in result.over_each.values()))
        covered += result.gain.low <= 0.05 <= result.gain.high
    assert np.mean(gains) == pytest.approx(0.05, abs=0.01)
    assert np.mean(lucky) < 0.025
    assert 0.89 <= covered / 150 <= 0.99


# Bad input

TWO = [0, 0, 1, 1]
ONES = [1.0, 0.0, 1.0, 1.0]
ARM = np.array(ONES)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: compare(ONES, ONES[1:], TWO, TWO), "a has 4 scores and b 3"),
        (lambda: compare([1, 0, np.nan, 0], ONES, TWO, TWO), r"a\[2\] is nan"),
        (lambda: compare(ONES, ONES, [0, 0, 0, 0], TWO), "there is 1 ego variant, 0"),
        (lambda: compare(ONES, ONES, TWO, ["o"] * 4), "there is 1 opponent variant, o"),
        (lambda: compare(ONES, ONES, TWO[1:], TWO), r"ego labels have shape \(3,\)"),
        (lambda: compare(ONES, ONES, TWO, TWO, start=[0, 0, 0, np.nan]), "start labels must be text or finite"),
        (lambda: compare(ONES, ONES, [None, 1, 2, 3], TWO), "ego labels must be text or finite numbers, not object"),
        (lambda: compare(ONES, ONES, [[1], 1, 2, 3], TWO), "ego labels must be text or numbers"),
        (lambda: compare(ONES, ONES, TWO, TWO, level=95), "level is 95"),
        (lambda: compare([], [], [], []), r"a has shape \(0,\)"),
        (lambda: compare(["win"] * 4, ONES, TWO, TWO), "a must be numbers"),
        (lambda: clustered_mean(ONES), "there are no cluster labels"),
        (lambda: clustered_mean(ONES, TWO, same_pool=True), "same_pool is about the labels of ego and opponent"),
        (lambda: compare(ONES, ONES, TWO, list("ooxx"), same_pool=True), "one pool has one kind"),
        (lambda: paired_t(ONES, ONES, [3] * 4), "there is 1 ego variant, 3"),
        (lambda: bootstrap_interval(ONES, TWO, TWO, np.random.default_rng(0), replicates=10), "replicates is 10"),
        (lambda: bootstrap_interval(ONES, TWO, TWO, np.random.default_rng(0)), "4 races of 2 egos and 2 opponents"),
        (lambda: sign_flip_p(np.ones(40), np.arange(40)), "needs an rng"),
        (lambda: sign_flip_p(np.ones(40), np.arange(40), np.random.default_rng(0), flips=9), "flips is 9"),
        (lambda: holm([0.1, 1.1]), r"p_values\[1\] is 1.1"),
        (lambda: effect_sizes([1.5, 0, 0, 0], ONES, TWO), r"a\[0\] is 1.5"),
        (lambda: wilson([1, 5], 4), "5 successes in 4 races"),
        (lambda: wilson(0, 0), "0 successes in 0 races"),
        (lambda: score([True], [True]), "race 0 is won and tied"),
        (lambda: score([True], [True, False]), r"won has shape \(1,\)"),
        (lambda: variance_components(ONES, TWO, [0, 1, 1, 1]), "have 0 to 2 races"),
        (lambda: power(0.1, VarianceComponents(1, 1, 1, -1)), "component unit is -1"),
        (lambda: power(0.1, VarianceComponents(1, 1, 1, 1), opponents=1), "opponents is 1"),
        (lambda: power(np.inf, VarianceComponents(1, 1, 1, 1)), "effect is inf"),
        (lambda: detectable_effect(VarianceComponents(1, 1, 1, 1), wanted=0.04), "wanted power is 0.04"),
        (
            lambda: adaptivity_gain(
                ONES, {"x": ARM, "y": TWO}, TWO, TWO, training={"x": ARM[::-1], "y": [0.5, 0.5, 0.5, 0.5]}
            ),
            "the training scores are the test scores",  # of one arm, the other way round
        ),
        (lambda: adaptivity_gain(ONES, {}, TWO, TWO, training={}), "there are no blind arms"),
        (lambda: adaptivity_gain(ONES, {"x": ONES}, TWO, TWO, training={"y": ONES}), "blind arm 'x' is in only one"),
        (
            lambda: adaptivity_gain(ONES, {"x": ONES, "y": ONES}, TWO, TWO, training={"x": [1], "y": [1, 0]}),
            r"have \[1, 2\] training races",
        ),
        (
            lambda: adaptivity_gain(ONES, {"x": ONES, "y": TWO}, TWO, TWO, training={"x": ONES, "y": TWO}),
            "the training scores are the test scores",
        ),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message) as error:
        call()
    assert "\n" not in str(error.value)


def test_the_pages_code_runs():
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert blocks
    exec(compile("\n".join(blocks), str(PAGE), "exec"), {"__name__": "page"})
