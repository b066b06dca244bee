from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from refusal import refused
from scipy.optimize import linprog

from pcs_racing_agents.solvers import solve_matrix_games


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


def gap(game: np.ndarray, row: np.ndarray, column: np.ndarray) -> Fraction:
    """Sum of both players' possible gains, in exact arithmetic, in units of the range."""
    exact = [[Fraction(value) for value in line] for line in game.tolist()]
    x, y = ([Fraction(value) for value in shares.tolist()] for shares in (row, column))
    best = max(sum(value * share for value, share in zip(line, y, strict=True)) for line in exact)
    least = min(
        sum(value * share for value, share in zip(line, x, strict=True))
        for line in zip(*exact, strict=True)
    )
    span = max(map(max, exact)) - min(map(min, exact))
    return (best / sum(y) - least / sum(x)) / (span or 1)


def check(games: np.ndarray, most: float = 1e-12) -> None:
    """Strategies are distributions, no player can gain more, and the value is between the gains."""
    solution = solve_matrix_games(games)
    low = games.min(axis=(1, 2))
    span = games.max(axis=(1, 2)) - low
    for shares in (solution.rows, solution.columns):
        assert (shares >= 0.0).all()
        assert shares.sum(axis=1) == pytest.approx(1.0, abs=1e-12)
    for game, row, column in zip(games, solution.rows, solution.columns, strict=True):
        assert gap(game, row, column) <= most
    reached = (
        solution.rows[:, None] @ (games - low[:, None, None]) @ solution.columns[:, :, None]
    ).reshape(-1)
    error = np.abs(solution.values - low - reached)
    assert (error <= 1e-11 * span + 1e-15 * np.abs(low) + 1e-321).all()


def test_games_known_by_hand_and_payoffs_of_all_sizes():
    pennies = [[1.0, -1.0], [-1.0, 1.0]]
    solution = solve_matrix_games(pennies)
    assert solution.values[0] == pytest.approx(0.0, abs=1e-15)
    assert solution.rows[0] == pytest.approx([0.5, 0.5])
    stones = solve_matrix_games([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])
    assert stones.columns[0] == pytest.approx([1 / 3] * 3)
    # A saddle point: row 1 and column 0 against any strategy.
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
    check(games * 10.0 ** rng.uniform(-9, 9, games.shape), 2e-7)
    check(games * 1e-300)
    check(games * 5e-320, 1e-3)  # a range of some thousand steps
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
    games = rng.normal(size=(100, *shape))
    games[:, -1] = games[:, 0]
    games[:, :, -1] = games[:, :, 0]
    check(games)
    for little in (1e-6, 1e-9, 1e-11, 1e-13, 1e-15):
        check(games + little * rng.normal(size=games.shape), 2e-7)
    for choices in (2, 3, 5):
        whole = rng.integers(0, choices, games.shape).astype(float)
        check(whole)
        check(whole + 1e-9 * rng.normal(size=games.shape), 2e-7)


@given(
    arrays(
        np.float64,
        st.tuples(st.just(1), st.integers(1, 6), st.integers(1, 6)),
        elements=st.integers(-3, 3),
    )
)
def test_games_of_whole_numbers(games):
    check(games, 1e-14)


def test_a_batch_makes_no_difference():
    games = np.random.default_rng(3).normal(size=(20, 4, 4))
    whole = solve_matrix_games(games)
    for i in (0, 7, 19):
        alone = solve_matrix_games(games[i])
        assert np.array_equal(alone.rows[0], whole.rows[i])
        assert alone.values[0] == whole.values[i]


def test_a_gap_is_measured_where_rounding_failed():
    games = np.random.default_rng(1).normal(size=(400, 4, 4))
    games[:, -1] = games[:, 0] + 1e-9 * games[:, 1]
    solution = solve_matrix_games(games)
    worst = int(solution.gaps.argmax())
    assert 1e-12 < solution.gaps[worst] < 1e-6
    exact = gap(games[worst], solution.rows[worst], solution.columns[worst])
    assert solution.gaps[worst] == pytest.approx(float(exact) * np.ptp(games[worst]), rel=1e-6)


def test_impossible_games():
    for games, message in [(np.zeros((2, 0)), "none of them 0"), ([[np.nan]], "must be finite")]:
        refused(message, solve_matrix_games, games)
