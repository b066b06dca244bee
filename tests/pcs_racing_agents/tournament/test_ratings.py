"""Ratings of simulated agents with known strengths."""

from collections import Counter
from itertools import combinations

import numpy as np
import pytest
from refusal import refused
from scipy.optimize import minimize

from pcs_racing_agents.tournament.race_files import race_table
from pcs_racing_agents.tournament.races import RaceRow, RaceTable
from pcs_racing_agents.tournament.ratings import (
    BATCH,
    _bootstrap,
    excess,
    max_entropy_equilibrium,
    rate,
    round_robin,
)

NAMES = ("a", "b", "c", "d", "e")
STRENGTH = np.array([1.0, 0.4, 0.0, -0.4, -1.0])
TIE = 0.6


def chances(strength, tie, i, j):
    """Davidson's model: chances of i winning, of a tie and of j winning."""
    parts = np.array(
        [np.exp(strength[i]), tie * np.exp(0.5 * (strength[i] + strength[j])), np.exp(strength[j])]
    )
    return parts / parts.sum()


def raced(first, second, result, unpaid=None, line=None) -> RaceTable:
    """Return races: 1 is a win of the first agent, -1 of the second, 0 a tie."""
    winners = {1: "ego", 0: "none", -1: "opponent"}
    count = len(first)
    crashed, starts = unpaid or [False] * count, range(count) if line is None else line
    return race_table(
        RaceRow(
            ego=str(ego),
            opponent=str(opponent),
            winner="none" if crash else winners[int(won)],
            crash="car" if crash else "none",
            start_s=float(start),
        )
        for ego, opponent, won, crash, start in zip(
            first, second, result, crashed, starts, strict=True
        )
    )


def simulate(rng, races, tie=TIE, strength=STRENGTH):
    """All pairs race; returns first, second and result."""
    first, second, result = [], [], []
    for i, j in combinations(range(len(strength)), 2):
        first += [NAMES[i]] * races
        second += [NAMES[j]] * races
        result += list(rng.choice([1, 0, -1], size=races, p=chances(strength, tie, i, j)))
    return first, second, np.array(result)


def test_strengths_and_ties_come_back_within_their_intervals():
    ratings = rate(raced(*simulate(np.random.default_rng(0), 2000)))
    assert ratings.names == NAMES
    assert ratings.strength == pytest.approx(STRENGTH, abs=0.08)
    assert ratings.tie == pytest.approx(TIE, abs=0.05)
    assert ratings.strength.sum() == pytest.approx(0.0, abs=1e-9)
    assert ratings.elo[0, 0] - ratings.elo[0, 1] == pytest.approx(0.6 * 400 / np.log(10), abs=20)
    assert np.isnan(ratings.low).all()
    assert ratings.races.tolist() == [8000] * 5
    rng = np.random.default_rng(3)
    covered = []
    for _ in range(30):
        ratings = rate(raced(*simulate(rng, 40)), rng=rng, replicates=100)
        covered.append((ratings.low <= STRENGTH) & (ratings.high >= STRENGTH))
        assert (ratings.low < ratings.strength).all()
    assert 0.88 <= np.mean(covered) <= 0.99


@pytest.mark.parametrize("tie", [TIE, 0.0])
def test_nothing_leads_uphill_from_the_fit_and_another_optimiser_finds_nothing_better(tie):
    """The log-posterior is strictly concave, so that it is highest where its gradient vanishes, and
    nowhere else.

    How close another optimiser comes to that place depends on the processor's rounding; its result
    is only compared in height.
    """
    first, second, result = simulate(np.random.default_rng(1), 25, tie)
    races = Counter(
        (NAMES.index(i), NAMES.index(j), r) for i, j, r in zip(first, second, result, strict=True)
    )

    def loss(x):
        weight = np.exp(x[-1]) if tie else 0.0
        log = sum(
            count * np.log(chances(x[:-1], weight, i, j)[1 - r])
            for (i, j, r), count in races.items()
        )
        return 0.5 * (x**2).sum() / 3.0**2 - log

    ratings = rate(raced(first, second, result))
    fit = np.append(ratings.strength, np.log(ratings.tie) if tie else 0.0)
    # A step along the imaginary axis takes no difference of nearly equal numbers: these derivatives
    # are exact.
    slopes = np.array([loss(fit + 1e-30j * axis).imag / 1e-30 for axis in np.eye(6)])
    assert np.abs(slopes).max() < 1e-9 * len(result)  # one race alone has a slope of up to 1
    assert (ratings.tie == 0.0) == (tie == 0.0)
    reference = minimize(loss, np.zeros(6), tol=1e-10).fun
    # the rounding error of a sum over the races
    assert reference >= loss(fit) - 1e-12 * len(result)
    assert reference == pytest.approx(loss(fit), rel=1e-6)


def test_intervals_repeat_and_know_of_shared_races():
    """Fifty copies of the same ten start lines are no more evidence than the ten."""
    rng = np.random.default_rng(4)
    first, second, result = simulate(rng, 10)
    copies = np.repeat(np.arange(len(first)), 50)
    many = [np.array(first)[copies], np.array(second)[copies], result[copies]]
    line = np.tile(np.arange(10), len(first) // 10)[copies]
    races, apart = raced(*many, line=line), raced(*many)
    alone, again, naive = (
        rate(one, rng=np.random.default_rng(5), replicates=200) for one in (races, races, apart)
    )
    assert (alone.low == again.low).all()
    draws = _bootstrap(np.arange(4), BATCH + 30, rng)
    assert len([row for batch in draws for row in batch]) == BATCH + 30
    # Of two lines each replicate has one twice or both once: a fit of each is in the interval's
    # ends.
    two = raced(["a"] * 6, ["b"] * 6, [1, 1, 1, -1, -1, 1], line=[1, 1, 1, 2, 2, 2])
    halves = rate(two, rng=np.random.default_rng(0))
    ends = [
        rate(raced(["a"] * 6, ["b"] * 6, half * 2)).strength[0] for half in ([-1, -1, 1], [1, 1, 1])
    ]
    assert (halves.low[0], halves.high[0]) == pytest.approx(ends)
    assert ((naive.high - naive.low) < 0.35 * (alone.high - alone.low)).all()


def test_an_agent_that_wins_everything_has_a_finite_rating():
    first, second = ["a"] * 20 + ["b"] * 20, ["b"] * 20 + ["c"] * 20
    races = raced(first, second, [1] * 20 + [1, -1] * 10)
    ratings = rate(races, rng=np.random.default_rng(0), replicates=100)
    assert ratings.strength[0] > 2.0
    assert np.isfinite([ratings.low, ratings.high]).all()
    assert ratings.strength[1] == pytest.approx(ratings.strength[2], abs=1.0)
    assert ratings.tie == 0.0
    # With 1,000 wins and a wide prior the slope of the log posterior is still zero at the answer.
    one = rate(raced(["a"] * 1000, ["b"] * 1000, [1] * 1000), prior_sd=1000.0).strength
    assert 1000 / (1 + np.exp(np.ptp(one))) == pytest.approx(one[0] / 1e6, rel=1e-6)


def test_races_that_paid_nobody_and_who_is_named_first_do_not_matter():
    first, second, result = simulate(np.random.default_rng(6), 30)
    crashed = [*first, "a", "a"], [*second, "e", "b"], [*result, 0, 0]
    ratings = rate(raced(*crashed, unpaid=[*[False] * len(first), True, True]))
    assert (ratings.strength == rate(raced(first, second, result)).strength).all()
    assert ratings.left_out.tolist() == [2, 1, 0, 0, 1]
    assert ratings.races.tolist() == [120] * 5
    first, second, result = simulate(np.random.default_rng(7), 20)
    assert rate(raced(second, first, -result)).strength == pytest.approx(
        rate(raced(first, second, result)).strength, abs=1e-9
    )


@pytest.mark.parametrize("sd", [1e-6, 1e6])
def test_the_prior_may_be_narrow_or_wide(sd):
    assert rate(raced(["a"], ["b"], [0]), prior_sd=sd).strength.tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("races", "options", "message"),
    [
        ((["a"], ["a"], [1]), {}, "a races itself"),
        ((["a"], ["b"], [1], [True]), {}, "all of 1 races"),
        ((["a", "b"], ["c", "d"], [1, 0]), {}, "b never met a"),
        ((["a"], ["b"], [1]), {"prior_sd": 9e-7}, "prior_sd is 9e-07"),
        ((["a"], ["b"], [1]), {"prior_sd": 1.1e6}, "prior_sd is 1100000"),
        ((["a"], ["b"], [1]), {"rng": np.random.default_rng(0)}, "the same unit"),
        ((["a"], ["b"], [1]), {"replicates": 5}, "replicates is 5"),
    ],
)
def test_bad_input(races, options, message):
    refused(message, rate, raced(*races), **options)


def test_no_races_are_refused():
    refused("there are no races", rate, raced(["a"], ["b"], [1]).take([]))


CYCLE = ("paper", "rock", "scissors")


def table(ego, opponent, winner, crashed, line):
    """Races given by their columns."""
    return race_table(
        RaceRow(
            ego=one,
            opponent=other,
            winner=who,
            crash="car" if crash else "none",
            start_s=float(start),
        )
        for one, other, who, crash, start in zip(ego, opponent, winner, crashed, line, strict=True)
    )


@pytest.fixture(scope="module")
def cycle():
    """Rock beats scissors beats paper beats rock; some ties, and crashes that pay neither."""
    races = 20
    ego = ["paper", "rock", "scissors"] * races
    opponent = ["rock", "scissors", "paper"] * races
    winner = (["ego"] * 3 * (races - 4)) + ["opponent"] * 3 + ["none"] * 9
    crashed = [False] * 3 * (races - 1) + [True] * 3
    line = [i // 6 for i in range(3 * races)]
    return table(ego, opponent, winner, crashed, line)


def test_scores_count_ties_half_and_ratings_see_no_cycle(cycle):
    result = round_robin(CYCLE, cycle)
    assert result.scores[0, 1] == pytest.approx((16 + 2 * 0.5) / 20)
    assert result.scores[1, 0] == pytest.approx((1 + 2 * 0.5) / 20)
    assert np.isnan(np.diag(result.scores)).all()
    assert result.ratings.left_out.tolist() == [2, 2, 2]
    assert result.ratings.elo[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert result.equilibrium == pytest.approx([1 / 3] * 3)
    assert excess(result.scores)[0, 1] == pytest.approx(0.375)
    rating, low, high = result.rating("rock")
    assert low <= rating <= high  # the three come up together in every draw
    assert result.ratings.strength == pytest.approx(rate(cycle).strength)


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ([[0, 0.5], [0.5, 0]], [0.5, 0.5]),
        ([[0, 0.55], [0.45, 0]], [1.0, 0.0]),
        # The first two tie and beat the third.
        ([[0, 0.5, 0.7], [0.5, 0, 0.6], [0.3, 0.4, 0]], [0.5, 0.5, 0.0]),
        ([[0, 1, 0], [0, 0, 1], [1, 0, 0]], [1 / 3] * 3),
        # A cycle where one win counts twice.
        ([[0, 1, 0.25], [0, 0, 0.75], [0.75, 0.25, 0]], [0.25, 0.25, 0.5]),
    ],
)
def test_agents_that_tie_share_the_equilibrium_in_any_order(scores, expected):
    for order in (np.arange(len(scores)), np.arange(len(scores))[::-1]):
        payoffs = excess(np.array(scores)[np.ix_(order, order)])
        found = max_entropy_equilibrium(payoffs)
        assert found == pytest.approx(np.array(expected)[order], abs=1e-6)
        assert (found @ payoffs).min() > -1e-7


def test_a_pair_without_races_leaves_its_results_unknown():
    result = round_robin(("a", "b", "c"), table(["a"], ["b"], ["ego"], [False], [1]))
    assert result.equilibrium is None
    assert np.isnan(result.scores[2]).all()
    assert np.isnan(result.rating("c")[0])
    for crashed in (True, False):
        undecided = round_robin(("a", "b"), table(["a"], ["b"], ["none"], [crashed], [1]))
        assert undecided.ratings is None
        assert np.isnan(undecided.rating("a")).all()
    refused("'d' .* a, b", round_robin, ("a", "b"), table(["a"], ["d"], ["ego"], [False], [1]))


@pytest.mark.parametrize(("lines", "enough"), [(5, True), (4, False)])
def test_an_interval_needs_enough_start_lines_with_paid_races(lines, enough):
    """On the first line car 0 wins by a crash of the other; the crash on the last one pays none."""
    line = [0, *(1 + i % (lines - 1) for i in range(19)), 9]
    ends, crashed = [*["ego", "opponent"] * 10, "none"], [True, *[False] * 19, True]
    races = table(["a"] * 21, ["b"] * 21, ends, crashed, line)
    result = round_robin(("a", "b"), races)
    assert np.isfinite(result.rating("a")).tolist() == [True, enough, enough]
