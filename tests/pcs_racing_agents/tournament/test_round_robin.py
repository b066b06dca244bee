"""All against all: scores, ratings, and the game of choosing an agent."""

import numpy as np
import pytest
from refusal import refused

from pcs_racing_agents.tournament.race_files import race_table
from pcs_racing_agents.tournament.races import RaceRow
from pcs_racing_agents.tournament.ratings import (
    excess,
    max_entropy_equilibrium,
    rate,
    round_robin,
)

NAMES = ("paper", "rock", "scissors")


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
    result = round_robin(NAMES, cycle)
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
    line, ends = [*(i % lines for i in range(20)), 9], [*["ego", "opponent"] * 10, "none"]
    races = table(["a"] * 21, ["b"] * 21, ends, [False] * 20 + [True], line)
    result = round_robin(("a", "b"), races)
    assert np.isfinite(result.rating("a")).tolist() == [True, enough, enough]
