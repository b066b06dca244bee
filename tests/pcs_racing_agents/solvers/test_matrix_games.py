import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from refusal import refused
from scipy.optimize import linprog

from pcs_racing_agents.solvers import matrix_games, solve_matrix_games
from pcs_racing_agents.solvers.rational_games import solve_rationally


def linear_program(game: np.ndarray) -> float:
    """Value of a matrix game by scipy."""
    a, c = game.shape
    objective = np.append(np.zeros(a), -1.0)
    solved = linprog(
        objective,
        A_ub=np.column_stack([-game.T, np.ones(c)]),
        b_ub=np.zeros(c),
        A_eq=[np.append(np.ones(a), 0.0)],
        b_eq=[1.0],
        bounds=[(0, None)] * a + [(None, None)],
    )
    return -solved.fun


def check(games: np.ndarray) -> None:
    """Strategies are distributions, and nobody could gain more than rounding errors."""
    solution = solve_matrix_games(games)
    for shares in (solution.rows, solution.columns):
        assert (shares >= 0.0).all()
        assert shares.sum(axis=1) == pytest.approx(1.0, abs=1e-12)
    low = games.min(axis=(1, 2))
    above = games - low[:, None, None]
    span = above.max(axis=(1, 2))
    most = (above @ solution.columns[:, :, None]).max(axis=(1, 2))
    least = (solution.rows[:, None, :] @ above).min(axis=(1, 2))
    assert (most - least <= 2e-12 * span + 1e-321).all()
    assert (
        np.abs(solution.values - low - most) <= 1e-11 * span + 1e-15 * np.abs(low) + 1e-321
    ).all()


def test_games_known_by_hand_and_payoffs_of_all_sizes():
    pennies = [[1.0, -1.0], [-1.0, 1.0]]
    solution = solve_matrix_games(pennies)
    assert solution.values[0] == pytest.approx(0.0, abs=1e-15)
    assert solution.rows[0] == pytest.approx([0.5, 0.5])
    stones = solve_matrix_games([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])
    assert stones.columns[0] == pytest.approx([1 / 3] * 3)
    # A saddle point: row 1 and column 0 whatever the other does.
    saddle = solve_matrix_games([[1.0, 5.0], [2.0, 3.0]])
    assert (saddle.values[0], saddle.rows[0].tolist(), saddle.columns[0].tolist()) == (
        2.0,
        [0.0, 1.0],
        [1.0, 0.0],
    )
    # Two of five moves (Dresher 1961): 2 x 4, row shares 5/6 and 1/6.
    wide = solve_matrix_games([[1.0, 2.0, 4.0, 7.0], [6.0, 4.0, -1.0, 0.0]])
    assert wide.values[0] == pytest.approx(
        linear_program(np.array([[1.0, 2.0, 4.0, 7.0], [6.0, 4.0, -1.0, 0.0]]))
    )
    rng = np.random.default_rng(2)
    games = rng.normal(size=(100, 4, 4))
    check(games * 10.0 ** rng.uniform(-9, 9, games.shape))
    check(games * 1e-300)
    check(games * 5e-320)
    check(games + 1e9)
    check(np.zeros((3, 4, 4)))


@pytest.mark.parametrize("shape", [(4, 4), (5, 5), (3, 7), (7, 2), (1, 4), (20, 20)])
def test_values_are_those_of_a_linear_program(shape):
    rng = np.random.default_rng(0)
    games = rng.normal(size=(8, *shape)) * 20.0 + 5.0
    solution = solve_matrix_games(games)
    assert solution.values == pytest.approx([linear_program(game) for game in games], abs=1e-8)
    check(games)


@pytest.mark.parametrize("shape", [(4, 4), (5, 5), (9, 9), (2, 7)])
def test_games_with_equal_and_nearly_equal_moves(shape):
    """Moves that lead to the same policy have the same row; rounding makes others differ by next to
    nothing.
    """
    rng = np.random.default_rng(1)
    games = rng.normal(size=(400, *shape))
    games[:, -1] = games[:, 0]
    games[:, :, -1] = games[:, :, 0]
    check(games)
    for little in (1e-6, 1e-9, 1e-11, 1e-13, 1e-15):
        check(games + little * rng.normal(size=games.shape))
    for choices in (2, 3, 5):
        whole = rng.integers(0, choices, games.shape).astype(float)
        check(whole)
        check(whole + 1e-9 * rng.normal(size=games.shape))


@given(
    arrays(
        np.float64,
        st.tuples(st.just(1), st.integers(1, 6), st.integers(1, 6)),
        elements=st.integers(-3, 3),
    )
)
def test_floats_agree_with_whole_numbers(games):
    value, row, column = solve_rationally(games[0])
    assert solve_matrix_games(games).values[0] == pytest.approx(value, abs=1e-14)
    assert (games[0] @ column).max() == pytest.approx(value, abs=1e-14)
    assert (row @ games[0]).min() == pytest.approx(value, abs=1e-14)
    assert row.sum() == pytest.approx(1.0)
    assert column.sum() == pytest.approx(1.0)


def test_ordinary_games_need_no_exact_arithmetic_whatever_the_batch(monkeypatch):
    games = np.random.default_rng(3).normal(size=(20, 4, 4))
    whole = solve_matrix_games(games)
    for i in (0, 7, 19):
        alone = solve_matrix_games(games[i])
        assert np.array_equal(alone.rows[0], whole.rows[i])
        assert alone.values[0] == whole.values[i]
    # The exact solver, a thousand times as slow, is there for games that rounding errors spoil.
    monkeypatch.setattr(matrix_games, "solve_rationally", None)
    check(np.random.default_rng(4).normal(size=(200, 5, 4)))


def test_what_both_could_gain_over_an_exact_solution_is_measured_too(monkeypatch):
    """With exact solutions that are pretended; a game is solved again where its gap is too large
    for its range.
    """
    games = np.array([[[0.0, 4.0], [4.0, 0.0]], [[1.0, 1.0], [1.0, 1.0]], [[3.0, 1.0], [1.0, 3.0]]])
    asked = []

    def pretend(game):
        asked.append(game)
        return 2.5, np.array([0.75, 0.25]), np.array([0.5, 0.5])

    monkeypatch.setattr(matrix_games, "solve_rationally", pretend)
    # too large is any gap, but for a game without a range
    monkeypatch.setattr(matrix_games, "GOOD_GAP", -1e-9)
    solution = solve_matrix_games(games)
    np.testing.assert_array_equal(asked, games[[0, 2]])
    assert solution.values.tolist() == [2.5, 1.0, 2.5]
    np.testing.assert_array_equal(solution.rows[[0, 2]], [[0.75, 0.25]] * 2)
    # The column player gets the row player down from 2 to 1, or from 2 to 1.5; mixing evenly the
    # row player gets 2.
    assert solution.gaps.tolist() == [2.0 - 1.0, 0.0, 2.0 - 1.5]


def test_impossible_games():
    for games, message in [(np.zeros((2, 0)), "none of them 0"), ([[np.nan]], "must be finite")]:
        refused(message, solve_matrix_games, games)
