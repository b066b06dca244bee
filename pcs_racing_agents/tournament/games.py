"""Batches of games between two competitors, from given starts.

Tournaments, studies and fits all play through :func:`play_each`. The result of a game does not depend on the batch
that it is played in, on the number of threads, or on earlier games.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.competitor import check_competitor, competitor_name
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import take_games
from pcs_racing.planners.planner import Policy
from pcs_racing.race.rates import DT
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.agent import Competitor, Driver, as_competitor
from pcs_racing_agents.tournament.shared_driving import SharedGames, drive_shared

BATCH = 4096  # games advanced together: bounded memory

CARS = ("ego", "opponent")


class PlayedGames(NamedTuple):
    """Results of a batch of B games of m moves; the ego drove car 0."""

    lead: NDArray[np.float64]  #: shape (B,): Progress of the ego minus that of the opponent at the end, m.
    #: shape (B,): 0 for the ego, 1 for the opponent, -1 for a tie and for a crash without a winner.
    winner: NDArray[np.int8]
    utility: NDArray[np.float64]  #: shape (B,): Utility of the ego.
    crash: NDArray[np.int8]  #: shape (B, 2): 0 none, 1 into a wall, 2 with the other car.
    fault: NDArray[np.int8]  #: shape (B, 2): 1 for a car that is to blame for the crash.
    overtakes: NDArray[np.int64]  #: shape (B, 2): How often each passed the other.
    duration: NDArray[np.float64]  #: shape (B,): Length of the race, s; shorter after a crash.
    #: shape (B, 2, m + 1): Policy of the archive that was driven in each step; -1 for a driver and for steps after a
    #: crash.
    policy: NDArray[np.int64]
    moves: NDArray[np.int64]  #: shape (B, 2, m): Moves made; -1 for a driver and after a crash.
    #: shape (B,): Key of the noise, with which :func:`pcs_racing_agents.tournament.watching.record_game` drives a game
    #: again.
    noise: NDArray[np.uint64]
    #: shape (B, 2, D): Last observations of both cars; they include the earlier ones.
    observations: NDArray[np.float32]

    @property
    def tie(self) -> NDArray[np.bool_]:
        """Whether a game ended level, without a crash, shape (B,)."""
        return (self.winner < 0) & ~self.crash.any(axis=1)

    @property
    def score(self) -> NDArray[np.float64]:
        """Score of the ego, shape (B,): 1 for a win, a half for a tie, else 0 (also for a crash without a winner)."""
        return (self.winner == 0) + 0.5 * self.tie


def join_played(parts: "list[PlayedGames]") -> PlayedGames:
    """Join batches into one."""
    return PlayedGames._make(np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def variant_count(game: RaceGame, competitor: Competitor) -> int:
    """Return how many variants a competitor has: a driver's policies, else the archive's, with which it may start."""
    return len(competitor.policies) if isinstance(competitor, Driver) else len(game.archive)


def game_between(game: RaceGame, ego: Competitor, opponent: Competitor) -> RaceGame:
    """Return the game in which two competitors meet: with the move "stay", and with their planners."""
    planners = [car.planner if isinstance(car, Driver) else None for car in (ego, opponent)]
    config = game.config if game.config.stay else replace(game.config, stay=True)
    arena = replace(game, config=config, ego_planner=planners[0], opponent_planner=planners[1])
    for car in (ego, opponent):
        check_competitor(arena, car)
    return arena


def play_games(
    game: RaceGame,
    ego: Competitor | Policy,
    opponent: Competitor | Policy,
    *,
    policies: ArrayLike,
    starts: Starts,
    seeds: ArrayLike,
) -> PlayedGames:
    """Play games between two competitors.

    Parameters
    ----------
    game : RaceGame
        Track, archive and rules. The move "stay" is added if the rules do not offer it.
    ego, opponent : Agent, Driver, Policy, or object with ``predict`` or ``decide``
        Who drives car 0 and car 1.
    policies : array_like of int, shape (B, 2)
        Variant of each: the policy of the archive to start with; for a driver which of its policies.
    starts : Starts
        B of them.
    seeds : array_like of int, shape (B,)
        Keys of the games' noise.
    """
    (played,) = play_each(game, [ego], opponent, policies=policies, starts=starts, seeds=seeds)
    return played


def play_each(
    game: RaceGame,
    egos: Sequence[Competitor | Policy],
    opponent: Competitor | Policy,
    *,
    policies: ArrayLike,
    starts: Starts,
    seeds: ArrayLike,
) -> list[PlayedGames]:
    """Play the same games with each of several egos, in less time than one after the other.

    What is the same in the games of two egos is driven once (:mod:`pcs_racing_agents.tournament.shared_driving`).

    Parameters
    ----------
    egos : sequence of K competitors
        Several of them only if none is a driver.
    game, opponent, policies, starts, seeds
        As for :func:`play_games`.

    Returns
    -------
    list of K PlayedGames
        What :func:`play_games` returns for each.
    """
    players = [as_competitor(ego) for ego in egos]
    other = as_competitor(opponent)
    if not players or (len(players) > 1 and any(isinstance(ego, Driver) for ego in players)):
        raise InputError(
            f"egos are {', '.join(map(competitor_name, players)) or 'nobody'}; give one or more, a driver only alone"
        )
    arena = game_between(game, players[0], other)
    for ego in players[1:]:
        check_competitor(arena, ego)
    keys = np.asarray(seeds)
    variants = np.asarray(policies)
    if variants.shape != (len(starts), 2) or variants.dtype.kind not in "iu" or keys.shape != (len(starts),):
        raise InputError(
            f"there are {len(starts)} starts, policies of shape {variants.shape} and seeds of shape {keys.shape}; they "
            f"must be whole numbers of shape ({len(starts)}, 2) and ({len(starts)},)"
        )
    for car, competitor in enumerate((players[0], other)):
        count = variant_count(arena, competitor)
        wrong = np.flatnonzero((variants[:, car] < 0) | (variants[:, car] >= count))
        if len(wrong):
            name = competitor_name(competitor)
            raise InputError(
                f"game {wrong[0]}: the {CARS[car]}'s variant is {variants[wrong[0], car]}; {name!r} has variants 0 to "
                f"{count - 1}"
            )
    parts = []
    size = max(1, BATCH // len(players))
    for first in range(0, max(len(starts), 1), size):
        rows = np.arange(first, min(first + size, len(starts)))
        shared = drive_shared(arena, players, other, variants[rows].astype(np.int64), starts.take(rows), keys[rows])
        parts.append([_played(arena, shared, k) for k in range(len(players))])
    return [join_played(list(of_ego)) for of_ego in zip(*parts, strict=True)]


def _played(arena: RaceGame, shared: SharedGames, ego: int) -> PlayedGames:
    """Results of the games of one of several egos."""
    state = take_games(shared.state, shared.branch[ego])
    race = state.race
    return PlayedGames(
        lead=race.lead,
        winner=arena.winner(state),
        utility=arena.reward(state)[:, 0],
        crash=race.crash,
        fault=race.fault,
        overtakes=race.overtakes,
        duration=np.asarray(race.tick * DT, np.float64),
        policy=shared.policy[ego],
        moves=shared.moves[ego],
        noise=race.seed,
        observations=arena.observation(state),
    )
