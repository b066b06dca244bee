"""Ratings of agents from race results, and the summary of a round robin.

The model of a rating is Bradley and Terry's with Davidson's ties.

Agent i beats j, loses to j or ties with j in proportion to ``exp(r_i)``, ``exp(r_j)`` and
``tie * exp((r_i + r_j) / 2)`` (Bradley and Terry 1952; Davidson 1970). No-contests (crashes without
a winner) are left out, and counted. They do not lower a rating, only the score.

In the meta-game of a round robin each player chooses an agent, and the score matrix gives the
payoffs. A rating is one number and can't represent cycles (a beats b, b beats c, c beats a); the
equilibrium of the meta-game can. Of several equilibria it is the one of maximum entropy, which does
not depend on the order of the agents (Nash averaging, Balduzzi et al. 2018).
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, check_number, check_whole
from pcs_racing.base.typing import Floats
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
    races: RaceTable,
    *,
    rng: np.random.Generator | None = None,
    replicates: int = 500,
    prior_sd: float = 3.0,
) -> Ratings:
    """Fit the strengths of agents to their races.

    The fit is the posterior mode under a weak normal prior on each strength: without the prior an
    agent without losses would have no finite rating. The intervals come from a bootstrap over the
    start places, since all pairs race from the same ones.

    Parameters
    ----------
    rng : numpy.random.Generator, optional
        Generator of the bootstrap; None for no intervals.
    replicates : int
        Number of bootstrap replicates, at least 100.
    prior_sd : float
        Standard deviation of the prior on the log-odds scale. 3 is weak: after 73 wins in 100 races
        between two agents it moves their strengths from 0.497 to 0.496.
    """
    check_number("prior_sd", prior_sd, 1e-6, 1e6)
    check_whole("replicates", replicates, 100)
    if not len(races):
        raise InputError("there are no races; ratings need at least one")
    # Sorted names, so that ratings do not depend on the order of races.
    names, places = np.unique(np.array(races.agents.words), return_inverse=True)
    number, agents = len(names), places[races.agents.codes]
    if (agents[:, 0] == agents[:, 1]).any():
        name = names[agents[np.argmax(agents[:, 0] == agents[:, 1]), 0]]
        raise InputError(f"{name!s} races itself; that says nothing about its strength")
    # A no-contest is no tie: it says nothing about strengths.
    left_out = races.crashed & (races.winner < 0)
    counted = np.flatnonzero(~left_out)
    if not len(counted):
        raise InputError(
            f"all of {len(races)} races are no-contests; ratings need at least one other race"
        )
    winner = np.take_along_axis(agents, np.maximum(races.winner, 0)[:, None], axis=1)[counted, 0]
    loser = agents.sum(axis=1)[counted] - winner
    tied = races.winner[counted] < 0
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
        draws = _bootstrap(races.places[counted], replicates, rng)
        replicated = np.concatenate([fit(weights)[0] for weights in draws])
        low, high = np.quantile(replicated, [0.025, 0.975], axis=0)
    return Ratings(
        names=tuple(str(name) for name in names),
        strength=strength[0],
        low=low,
        high=high,
        tie=float(tie[0]),
        races=np.bincount(agents[counted].ravel(), minlength=number),
        left_out=np.bincount(agents[left_out].ravel(), minlength=number),
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


def max_entropy_equilibrium(payoffs: ArrayLike) -> Floats:
    """Return the equilibrium of maximum entropy of a symmetric zero-sum game, shape (N,).

    ``payoffs`` (array_like, shape (N, N)): payoff of the row against the column; antisymmetric.
    """
    from scipy.optimize import minimize  # local: the imports take 0.3 s
    from scipy.special import logsumexp, softmax

    matrix = np.asarray(payoffs, np.float64)
    matrix = matrix / max(np.abs(matrix).max(), 1e-12)

    # The dual problem: a price for each opponent that the mixture does not beat or tie.
    def dual(prices: Floats) -> tuple[float, Floats]:
        gains = matrix @ prices
        return float(logsumexp(gains)), matrix.T @ softmax(gains)

    count = len(matrix)
    options = {"maxiter": 100_000, "maxfun": 100_000, "ftol": 0.0, "gtol": 1e-12}
    start, bounds = np.zeros(count), [(0.0, None)] * count
    found = minimize(dual, start, jac=True, bounds=bounds, method="L-BFGS-B", options=options)
    return np.asarray(softmax(matrix @ found.x))


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
    #: shape (N,): Probabilities of the agents in the equilibrium of the meta-game; None unless all
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
    # No-contests count in a score (as lost for both), but contain no information for ratings.
    won = races.score
    lost = np.where(races.crashed & (races.winner < 0), 0.0, 1.0 - won)
    total, count = np.zeros((2, len(names), len(names)))
    for ego, opponent, score in ((first, second, won), (second, first, lost)):
        np.add.at(total, (ego, opponent), score)
        np.add.at(count, (ego, opponent), 1.0)
    scores = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0.0)
    # A game with a missing payoff has no equilibrium; a mean as a substitute would invent a result.
    met = bool((count[~np.eye(len(names), dtype=bool)] > 0.0).all())
    return RoundRobin(
        names=tuple(names),
        scores=scores,
        ratings=_ratings(races, seed),
        equilibrium=max_entropy_equilibrium(excess(scores)) if met else None,
    )


def agents_of(names: Sequence[str], races: RaceTable) -> NDArray[np.intp]:
    """Return the agent in each car of each race as an index into ``names``, shape (N, 2)."""
    words = races.agents.words
    unknown = sorted({words[code] for code in np.unique(races.agents.codes).tolist()} - set(names))
    if unknown:
        raise InputError(f"{unknown[0]!r} raced, but is not one of {', '.join(names)}")
    index = np.array([names.index(word) if word in names else -1 for word in words], np.intp)
    return index[races.agents.codes]


def _ratings(races: RaceTable, seed: int) -> Ratings | None:
    """Fit the ratings, with intervals if there are enough start lines; None without a winner."""
    if (races.winner < 0).all():
        return None
    # A bootstrap over few lines draws almost the same lines again: its interval is too short.
    places = races.places[~races.crashed | (races.winner >= 0)]
    rng = None
    if len(np.unique(places)) >= MIN_LINES:
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(6_000_000,)))
    try:
        return rate(races, rng=rng)
    except InputError:  # groups of agents never met
        return None
