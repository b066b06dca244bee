"""Ratings of agents from race results, and the summary of a round robin.

The model of a rating is Bradley and Terry's with Davidson's ties.

Agent i beats j, loses to j or ties with j in proportion to ``exp(r_i)``, ``exp(r_j)`` and
``tie * exp((r_i + r_j) / 2)`` (Bradley and Terry 1952; Davidson 1970). No-contests (crashes without
a winner) are left out, and counted. They do not lower a rating, only the score.

In the meta-game of a round robin each player chooses an agent, and the score matrix gives the
payoffs. A rating is one number and can't represent cycles (a beats b, b beats c, c beats a); the
equilibrium of the meta-game can.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.typing import Floats
from pcs_racing_agents.solvers.matrix_games import solve_matrix_games
from pcs_racing_agents.tournament.races import RaceTable

BATCH = 100  # number of bootstrap replicates fitted together
ELO = 400.0 / np.log(10.0)


@dataclass(frozen=True, eq=False)
class Ratings:
    """Estimated strengths of N agents."""

    names: tuple[str, ...]  #: Names of N agents, sorted.
    #: shape (N,): Natural log-odds, mean 0; a difference of 1 means 2.7 wins per loss.
    strength: Floats
    #: shape (N,): ``low``, ``high``: 95 % bootstrap interval of the strength; NaN without a
    #: generator.
    low: Floats
    high: Floats
    tie: float  #: Weight of ties; equal agents tie with probability ``tie / (2 + tie)``.
    races: NDArray[np.intp]  #: shape (N,): Number of counted races.
    left_out: NDArray[np.intp]  #: shape (N,): Number of no-contests.

    @property
    def elo(self) -> Floats:
        """Strength, low and high as chess ratings (400 points are odds of ten), shape (3, N)."""
        return ELO * np.array([self.strength, self.low, self.high])


def rate(
    first: Sequence[str],
    second: Sequence[str],
    result: ArrayLike,
    *,
    unpaid: ArrayLike | None = None,
    unit: ArrayLike | None = None,
    rng: np.random.Generator | None = None,
    replicates: int = 500,
    prior_sd: float = 3.0,
) -> Ratings:
    """Fit the strengths of agents to their races.

    The fit is the posterior mode under a weak normal prior on each strength: without the prior an
    agent without losses would have no finite rating. The intervals come from a bootstrap over
    units: if all pairs raced from the same start lines, races from one line should have one unit.

    Parameters
    ----------
    result : array_like, shape (R,)
        1 for a win of the first agent, -1 for a win of the second agent, 0 for a tie.
    unpaid : array_like of bool, shape (R,), optional
        True for no-contests (crashes under the crash rule ``nobody``); their ``result`` is ignored.
    unit : array_like, shape (R,), optional
        Labels of the bootstrap units; by default each race is a unit.
    rng : numpy.random.Generator, optional
        Generator of the bootstrap; None for no intervals.
    replicates : int
        Number of bootstrap replicates, at least 100.
    prior_sd : float
        Standard deviation of the prior on the log-odds scale. 3 is weak: after 73 wins in 100 races
        between two agents it moves their strengths from 0.497 to 0.496.
    """
    if not 1e-6 <= prior_sd <= 1e6:
        raise InputError(f"prior_sd is {prior_sd!r}; it must be a number from 1e-6 to 1e6")
    if rng is not None and not replicates >= 100:
        raise InputError(f"replicates is {replicates!r}; an interval needs at least 100")
    races = len(first)
    if races == 0:
        raise InputError("there are no races; ratings need at least one")
    outcome = np.asarray(result, np.float64)
    uncounted = np.zeros(races, bool) if unpaid is None else np.asarray(unpaid, bool)
    units = np.arange(races) if unit is None else np.asarray(unit)
    for name, column in (
        ("second", np.asarray(second)),
        ("result", outcome),
        ("unpaid", uncounted),
        ("unit", units),
    ):
        if column.shape != (races,):
            raise InputError(
                f"{name} has shape {column.shape}; it must hold one value for each of {races} races"
            )
    # numpy sorts the names, so that ratings do not depend on the order of races.
    names, pairs = np.unique(
        np.array([list(first), list(second)], dtype=np.str_), return_inverse=True
    )
    number = len(names)
    first_agent, second_agent = pairs.reshape(2, -1)
    _check_races(names, first_agent, second_agent, outcome, uncounted)
    counted = np.flatnonzero(~uncounted)
    winner = np.where(outcome > 0.0, first_agent, second_agent)[counted]
    loser = np.where(outcome > 0.0, second_agent, first_agent)[counted]
    tied = outcome[counted] == 0.0
    # Index of a race in the table of wins (N x N), followed by the table of ties (N x N).
    cell = winner * number + loser + tied * number**2
    # Only meetings matter here, not results: the prior makes a rating without losses finite, but
    # between groups without meetings it would be the only information.
    _check_connected(names, winner, loser)

    def fit(weights: Iterable[NDArray[Any]]) -> tuple[Floats, Floats]:
        size = 2 * number**2
        counts = np.array([np.bincount(cell, w, minlength=size) for w in weights])
        wins, ties = counts.reshape(-1, 2, number, number).swapaxes(0, 1)
        return _fit(wins, ties + ties.swapaxes(1, 2), prior_sd, bool(tied.any()))

    strength, tie = fit(np.ones((1, len(cell))))
    low = high = np.full(number, np.nan)
    if rng is not None:
        replicated = np.concatenate(
            [fit(weights)[0] for weights in _bootstrap(units[counted], replicates, rng)]
        )
        low, high = np.quantile(replicated, [0.025, 0.975], axis=0)
    both = np.concatenate([first_agent, second_agent])
    out = np.concatenate([uncounted, uncounted])
    return Ratings(
        names=tuple(str(name) for name in names),
        strength=strength[0],
        low=low,
        high=high,
        tie=float(tie[0]),
        races=np.bincount(both[~out], minlength=number),
        left_out=np.bincount(both[out], minlength=number),
    )


def _bootstrap(
    units: NDArray[Any], replicates: int, rng: np.random.Generator
) -> Iterator[Iterator[NDArray[np.int64]]]:
    """Yield the race weights of each replicate (draw counts of the race's unit), in batches."""
    labels, codes = np.unique(units, return_inverse=True)
    if len(labels) < 2:
        raise InputError("all races have the same unit; intervals need at least 2 to draw from")
    for begin in range(0, replicates, BATCH):
        size = min(BATCH, replicates - begin)
        counts = rng.multinomial(len(labels), np.full(len(labels), 1.0 / len(labels)), size=size)
        # One row at a time: there may be many races.
        yield (row[codes] for row in counts)


def _fit(wins: Floats, ties: Floats, prior_sd: float, with_ties: bool) -> tuple[Floats, Floats]:
    """Fit B tables of wins (B, N, N) and ties (B, N, N; symmetric).

    Return strengths (B, N) and weights of ties (B,). The method is Newton's on the concave
    log-posterior; a step is halved until it does not lead downhill.
    """
    batch, number = wins.shape[:2]
    games = wins + wins.swapaxes(1, 2) + ties
    precision = 1.0 / prior_sd**2
    # The last unknown is the logarithm of the weight of ties: it has no bounds, and the
    # log-posterior is concave in it.
    x = np.zeros((batch, number + 1))
    diagonal = np.arange(number)
    for _ in range(100):
        chance, tie = _chances(x, with_ties)
        other = chance.swapaxes(1, 2)
        # wins - games * chance, without cancellation for a chance close to 1; ties below likewise.
        surprise = wins * (other + tie) - (games - wins) * chance
        gradient = -precision * x
        gradient[:, :number] += 0.5 * (surprise - surprise.swapaxes(1, 2)).sum(axis=2)
        curvature = np.zeros((batch, number + 1, number + 1))
        laplacian = games * (chance * other + 0.25 * tie * (chance + other))
        # Races determine only differences: the mean stays at the prior's 0. The 1 stiffens this
        # direction against rounding errors.
        curvature[:, :number, :number] = 1.0 - laplacian
        curvature[:, diagonal, diagonal] += laplacian.sum(axis=2)
        if with_ties:
            gradient[:, number] += 0.5 * (ties * (chance + other) - (games - ties) * tie).sum(
                axis=(1, 2)
            )
            mixed = -0.5 * (games * (chance - other) * tie).sum(axis=2)
            curvature[:, :number, number] = curvature[:, number, :number] = mixed
            curvature[:, number, number] = 0.5 * (games * tie * (chance + other)).sum(axis=(1, 2))
        curvature[:, np.arange(number + 1), np.arange(number + 1)] += precision
        step = np.linalg.solve(curvature, gradient[..., None])[..., 0]
        # Full steps can overshoot if an agent won nearly all races. A decrease by rounding errors
        # is not downhill.
        before = _log_posterior(x, wins, ties, precision, with_ties)
        for _ in range(40):
            after = _log_posterior(x + step, wins, ties, precision, with_ties)
            downhill = after < before - 1e-10 * (1.0 + np.abs(before))
            if not downhill.any():
                break
            step[downhill] *= 0.5
        x += step
        if np.abs(step).max() < 1e-9:
            return x[:, :number], np.exp(x[:, number]) if with_ties else np.zeros(batch)
    raise RuntimeError("the ratings did not converge")  # strictly concave: unexpected


def _chances(x: Floats, with_ties: bool) -> tuple[Floats, Floats]:
    """Return the probabilities of a win of the row's agent and of a tie, both (B, N, N)."""
    # Divide by the maximum of the three terms to avoid an overflow.
    half = 0.5 * (x[:, :-1, None] - x[:, None, :-1])
    tie = (
        np.broadcast_to(x[:, -1, None, None], half.shape)
        if with_ties
        else np.full_like(half, -np.inf)
    )
    top = np.maximum(np.abs(half), tie)
    win, draw = np.exp(half - top), np.exp(tie - top)
    total = win + np.exp(-half - top) + draw
    return win / total, draw / total


def _log_posterior(
    x: Floats, wins: Floats, ties: Floats, precision: float, with_ties: bool
) -> Floats:
    chance, tie = _chances(x, with_ties)
    # A count of 0 times the logarithm of a chance of 0 is 0 here, but NaN in numpy.
    with np.errstate(divide="ignore", invalid="ignore"):
        log = np.where(wins > 0.0, wins * np.log(chance), 0.0) + np.where(
            ties > 0.0, 0.5 * ties * np.log(tie), 0.0
        )
    return log.sum(axis=(1, 2)) - 0.5 * precision * (x**2).sum(axis=1)


def _check_races(
    names: NDArray[np.str_],
    first_agent: NDArray[np.intp],
    second_agent: NDArray[np.intp],
    outcome: Floats,
    uncounted: NDArray[np.bool_],
) -> None:
    if (first_agent == second_agent).any():
        name = names[first_agent[np.argmax(first_agent == second_agent)]]
        raise InputError(f"{name!s} races itself; that says nothing about its strength")
    wrong = ~uncounted & ~np.isin(outcome, (-1.0, 0.0, 1.0))
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InputError(f"result[{at}] is {outcome[at]:g}; it must be 1, 0 or -1")
    if uncounted.all():
        raise InputError(
            f"all of {len(uncounted)} races are no-contests; ratings need at least one other race"
        )


def _check_connected(
    names: NDArray[np.str_], winner: NDArray[np.intp], loser: NDArray[np.intp]
) -> None:
    """Raise InputError unless a chain of races connects every two agents."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    meetings = coo_array((np.ones(len(winner)), (winner, loser)), shape=(len(names),) * 2)
    group = connected_components(meetings, directed=False)[1]
    apart = group != group[0]
    if apart.any():
        raise InputError(
            f"{names[np.argmax(apart)]!s} never met {names[0]!s} or any that did; they can't be"
            " compared"
        )


def excess(scores: ArrayLike) -> Floats:
    """Return the zero-sum payoffs of a score matrix: half of ``scores - scores.T``.

    ``scores`` (array_like, shape (N, N)): score of the row's agent against the column's agent. The
    diagonal is not used.
    """
    matrix = np.array(scores, dtype=np.float64)
    np.fill_diagonal(matrix, 0.0)
    return 0.5 * (matrix - matrix.T)


MIN_LINES = 5
"""Minimum number of start lines for a bootstrap interval."""


@dataclass(frozen=True, eq=False)
class RoundRobin:
    """Results of a round robin of N agents."""

    names: tuple[str, ...]  #: Names of N agents.
    #: shape (N, N): Score of the row's agent against the column's agent: share of races won, a tie
    #: counting half; NaN for pairs without races.
    scores: Floats
    ratings: Ratings | None  #: Ratings of the agents; None if they can't be estimated.
    #: shape (N,): Probabilities of the agents in an equilibrium of the meta-game; None unless all
    #: pairs met.
    equilibrium: Floats | None

    def rating(self, name: str) -> tuple[float, float, float]:
        """Return an agent's Elo-scale rating and both ends of its interval; NaN if unknown."""
        if self.ratings is None or name not in self.ratings.names:
            return np.nan, np.nan, np.nan
        value, low, high = self.ratings.elo[:, self.ratings.names.index(name)].tolist()
        return value, low, high


def round_robin(names: Sequence[str], races: RaceTable, *, seed: int = 0) -> RoundRobin:
    """Summarise the races of a round robin.

    ``races``: races with the same start lines for all pairs. A crash without a winner is no tie.
    """
    first, second = agents_of(names, races).T
    # A winner of -1 (a tie or a no-contest) indexes the last element.
    won = np.array([1.0, -1.0, 0.0])[races.winner]
    # No-contests count in a score (as lost for both), but contain no information for ratings.
    unpaid = races.crashed & (won == 0.0)
    total, count = np.zeros((len(names),) * 2), np.zeros((len(names),) * 2)
    paid = np.where(unpaid, 0.0, 0.5)
    np.add.at(total, (first, second), paid * (1.0 + won))
    np.add.at(total, (second, first), paid * (1.0 - won))
    np.add.at(count, (first, second), 1.0)
    np.add.at(count, (second, first), 1.0)
    scores = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0.0)
    # A game with a missing payoff has no equilibrium; a mean as a substitute would invent a result.
    met = bool((count[~np.eye(len(names), dtype=bool)] > 0.0).all())
    return RoundRobin(
        names=tuple(names),
        scores=scores,
        ratings=_ratings(
            np.array(names)[first], np.array(names)[second], won, unpaid, races.places, seed
        ),
        equilibrium=solve_matrix_games(excess(scores)).rows[0] if met else None,
    )


def agents_of(names: Sequence[str], races: RaceTable) -> NDArray[np.intp]:
    """Return the agent in each car of each race as an index into ``names``, shape (N, 2)."""
    words = races.agents.words
    unknown = sorted({words[code] for code in np.unique(races.agents.codes).tolist()} - set(names))
    if unknown:
        raise InputError(f"{unknown[0]!r} raced, but is not one of {', '.join(names)}")
    index = np.array([names.index(word) if word in names else -1 for word in words], np.intp)
    return index[races.agents.codes]


def _ratings(
    ego: NDArray[np.str_],
    opponent: NDArray[np.str_],
    won: Floats,
    unpaid: NDArray[np.bool_],
    line: NDArray[np.intp],
    seed: int,
) -> Ratings | None:
    """Fit the ratings, with intervals if there are enough start lines."""
    # A bootstrap over few lines draws almost the same lines again: its interval is too short.
    several = len(np.unique(line[~unpaid])) >= MIN_LINES
    rng = (
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(6_000_000,)))
        if several
        else None
    )
    try:
        return rate(ego.tolist(), opponent.tolist(), won, unpaid=unpaid, unit=line, rng=rng)
    except InputError:  # no race counts, or groups of agents never met
        return None
