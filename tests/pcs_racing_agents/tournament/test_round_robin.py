"""All against all: scores, ratings, and the game of choosing an agent, from the lines of a results
file.
"""

import numpy as np
import pytest
from refusal import refused

from pcs_racing_agents.tournament.race_files import race_table
from pcs_racing_agents.tournament.races import RaceRow
from pcs_racing_agents.tournament.ratings import rate
from pcs_racing_agents.tournament.round_robin import alpha_rank, excess, round_robin

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


def cycle(races: int = 20):
    """Rock beats scissors beats paper beats rock; some ties, and crashes that pay neither."""
    ego = ["paper", "rock", "scissors"] * races
    opponent = ["rock", "scissors", "paper"] * races
    winner = (["ego"] * 3 * (races - 4)) + ["opponent"] * 3 + ["none"] * 9
    crashed = [False] * 3 * (races - 1) + [True] * 3
    line = [i // 6 for i in range(3 * races)]
    return table(ego, opponent, winner, crashed, line)


def test_scores_count_ties_half_and_ratings_see_no_cycle():
    result = round_robin(NAMES, cycle())
    assert result.scores[0, 1] == pytest.approx((16 + 2 * 0.5) / 20)
    assert result.scores[1, 0] == pytest.approx((1 + 2 * 0.5) / 20)
    assert np.isnan(np.diag(result.scores)).all()
    assert result.ratings.left_out.tolist() == [2, 2, 2]
    scores = np.array([[np.nan, 0.5], [0.1, np.nan]])  # 40 % of the races paid nobody
    assert excess(scores) == pytest.approx(np.array([[0.0, 0.2], [-0.2, 0.0]]))
    assert np.isnan(scores[0, 0])
    pytest.importorskip("pyspiel")
    assert result.ratings.elo == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert result.equilibrium == pytest.approx([1 / 3] * 3)
    assert result.alpha_rank == pytest.approx([1 / 3] * 3)
    assert excess(result.scores)[0, 1] == pytest.approx(0.375)
    rating, low, high = result.rating("rock")
    assert low <= rating <= high  # the three come up together in every draw


def test_the_ratings_are_those_of_rate_and_what_is_not_told_is_left_open():
    races = cycle()
    won = np.array([{"ego": 1.0, "opponent": -1.0, "none": 0.0}[row.winner] for row in races])
    expected = rate(
        [row.ego for row in races], [row.opponent for row in races], won, unpaid=races.crashed
    )
    result = round_robin(NAMES, races, seed=3)
    assert result.ratings.strength == pytest.approx(expected.strength)
    again = round_robin(NAMES, races, seed=3)
    assert (again.ratings.low == result.ratings.low).all()
    result = round_robin(("a", "b", "c"), table(["a"], ["b"], ["ego"], [False], [1]))
    assert result.equilibrium is result.alpha_rank is None
    assert np.isnan(result.noise)
    assert np.isnan(result.scores[2]).all()
    assert np.isnan(result.rating("c")[0])
    nothing = round_robin(("a", "b"), table(["a"], ["b"], ["none"], [True], [1]))
    assert nothing.ratings is None
    assert np.isnan(nothing.rating("a")).all()


def test_what_start_lines_decide_counts_as_noise():
    """Won on every second line, lost on the others: that may be nothing, whatever the number of
    races on a line.
    """
    line = [i // 4 for i in range(32)]
    winner = ["ego" if (i // 4) % 2 else "opponent" for i in range(32)]
    result = round_robin(("a", "b"), table(["a"] * 32, ["b"] * 32, winner, [False] * 32, line))
    assert result.noise == pytest.approx(1.96 * np.sqrt(8 / 7 / 8))
    sure = round_robin(("a", "b"), table(["a"] * 32, ["b"] * 32, ["ego"] * 32, [False] * 32, line))
    assert sure.noise == 0.0
    assert sure.equilibrium == pytest.approx([1.0, 0.0])
    # for an interval of a rating; a line without a paid race is none
    for lines, enough in ((5, True), (4, False)):
        line, ends = [*(i % lines for i in range(20)), 9], [*["ego", "opponent"] * 10, "none"]
        result = round_robin(
            ("a", "b"), table(["a"] * 21, ["b"] * 21, ends, [False] * 20 + [True], line)
        )
        assert np.isfinite(result.rating("a")).tolist() == [True, enough, enough]


CYCLE = np.array([[0.5, 0.6, 0.3], [0.4, 0.5, 0.7], [0.7, 0.3, 0.5]])
LADDER = np.array([[0.5, 0.6, 0.7], [0.4, 0.5, 0.7], [0.3, 0.3, 0.5]])


def test_alpha_rank_prefers_who_beats_all_and_keeps_cycles():
    pytest.importorskip("pyspiel")
    pytest.importorskip("networkx")
    assert alpha_rank(LADDER)[0] > 0.99
    assert alpha_rank(CYCLE) == pytest.approx(np.full(3, 1 / 3))
    assert alpha_rank(LADDER, tolerance=0.25) == pytest.approx([0.5, 0.5, 0.0], abs=0.01)
    # Two agents, a beats b: a is taken over with a probability of 0.001, b with 0.999.
    assert alpha_rank([[0.5, 0.8], [0.2, 0.5]]) == pytest.approx([0.999, 0.001])
    races = table(["a"] * 4, ["b"] * 4, ["ego"] * 4, [False] * 4, range(4))
    assert round_robin(("a", "b"), races).alpha_rank == pytest.approx([0.999, 0.001])


def test_a_missing_library_is_named_with_its_extra(monkeypatch):
    monkeypatch.setattr(
        "pcs_racing.base.errors.find_spec", lambda name: None if name == "pyspiel" else object()
    )
    with pytest.raises(ModuleNotFoundError, match=r"\[games\]") as error:
        alpha_rank(CYCLE)
    assert error.value.name == "pyspiel"


def test_bad_input():
    for call, value in [
        (
            lambda: round_robin(("a", "b"), table(["a"], ["d"], ["ego"], [False], [1])),
            "'d' .* a, b",
        ),
        (lambda: excess([]), r"\(0,\)"),
        (lambda: excess([["a"]]), "numbers"),
        (lambda: excess([[1.0, 2.0]]), r"\(1, 2\)"),
        (lambda: excess([[0.5, np.nan], [0.5, 0.5]]), "row 0 .* column 1 is nan"),
        (lambda: alpha_rank([[0.5]]), "1 agent"),
        (lambda: alpha_rank(CYCLE, tolerance=-1.0), "tolerance is -1"),
    ]:
        refused(value, call)
