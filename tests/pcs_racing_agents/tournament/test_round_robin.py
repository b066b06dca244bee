"""All against all: scores, ratings, and the game of choosing an agent, from the lines of a results file."""

import numpy as np
import pytest

from pcs_racing import InputError
from pcs_racing_agents.results.race_files import race_table
from pcs_racing_agents.results.races import RaceRow
from pcs_racing_agents.tournament.ratings import rate
from pcs_racing_agents.tournament.round_robin import excess, round_robin

NAMES = ("paper", "rock", "scissors")


def table(ego, opponent, winner, crashed, line):
    """Races given by their columns."""
    return race_table(
        RaceRow(ego=one, opponent=other, winner=who, crash="car" if crash else "none", start_s=float(start))
        for one, other, who, crash, start in zip(ego, opponent, winner, crashed, line, strict=True)
    )


def cycle(races: int = 20):
    """Rock beats scissors beats paper beats rock; some ties, and crashes that pay neither."""
    ego = ["paper", "rock", "scissors"] * races
    opponent = ["rock", "scissors", "paper"] * races
    winner = (["ego"] * 3 * (races - 4)) + ["opponent"] * 3 + ["none"] * 9
    crashed = [False] * 3 * (races - 1) + [True] * 3
    line = [i // 6 for i in range(3 * races)]
    return table(ego, opponent, winner, crashed, line)


def test_scores_count_ties_half_and_crashes_not_at_all():
    result = round_robin(NAMES, cycle())
    assert result.scores[0, 1] == pytest.approx((16 + 2 * 0.5) / 20)
    assert result.scores[1, 0] == pytest.approx((1 + 2 * 0.5) / 20)
    assert np.isnan(np.diag(result.scores)).all()
    assert result.ratings.left_out.tolist() == [2, 2, 2]


def test_a_rating_sees_no_cycle_and_the_rest_does():
    pytest.importorskip("pyspiel")
    result = round_robin(NAMES, cycle())
    assert result.ratings.elo == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert result.equilibrium == pytest.approx([1 / 3] * 3)
    assert result.alpha_rank == pytest.approx([1 / 3] * 3)
    assert excess(result.scores)[0, 1] == pytest.approx(0.375)
    rating, low, high = result.rating("rock")
    assert low <= rating <= high  # the three come up together in every draw


def test_the_ratings_are_those_of_rate():
    races = cycle()
    won = np.array([{"ego": 1.0, "opponent": -1.0, "none": 0.0}[row.winner] for row in races])
    expected = rate([row.ego for row in races], [row.opponent for row in races], won, unpaid=races.crashed)
    result = round_robin(NAMES, races, seed=3)
    assert result.ratings.strength == pytest.approx(expected.strength)
    again = round_robin(NAMES, races, seed=3)
    assert (again.ratings.low == result.ratings.low).all()


def test_what_start_lines_decide_counts_as_noise():
    """Won on every second line, lost on the others: that may be nothing, whatever the number of races on a line."""
    line = [i // 4 for i in range(32)]
    winner = ["ego" if (i // 4) % 2 else "opponent" for i in range(32)]
    result = round_robin(("a", "b"), table(["a"] * 32, ["b"] * 32, winner, [False] * 32, line))
    assert result.noise == pytest.approx(1.96 * np.sqrt(8 / 7 / 8))
    sure = round_robin(("a", "b"), table(["a"] * 32, ["b"] * 32, ["ego"] * 32, [False] * 32, line))
    assert sure.noise == 0.0


def test_what_the_races_do_not_tell_is_left_open():
    result = round_robin(("a", "b", "c"), table(["a"], ["b"], ["ego"], [False], [1]))
    assert result.equilibrium is result.alpha_rank is None
    assert np.isnan(result.noise)
    assert np.isnan(result.scores[2]).all()
    assert np.isnan(result.rating("c")[0])
    nothing = round_robin(("a", "b"), table(["a"], ["b"], ["none"], [True], [1]))
    assert nothing.ratings is None
    assert np.isnan(nothing.rating("a")).all()


def test_strangers_are_refused():
    with pytest.raises(InputError, match="'d' raced, but is not one of a, b"):
        round_robin(("a", "b"), table(["a"], ["d"], ["ego"], [False], [1]))
