"""Recording of single games for replays."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import InputError
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import Policy
from pcs_racing.race.recording import record_drive
from pcs_racing.race.replay import Replay
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.agent import Competitor, Driver, as_competitor
from pcs_racing_agents.results.races import RaceTable
from pcs_racing_agents.tournament.games import game_between
from pcs_racing_agents.tournament.pairings import Pairing
from pcs_racing_agents.tournament.runner import race_table


class Recording(NamedTuple):
    """A recorded game."""

    replay: Replay
    played: RaceTable  #: Result of the one game, with the observations of both cars.
    game: RaceGame  #: The game as it was played, with the planners of both cars.


def record_game(
    game: RaceGame,
    ego: Competitor | Policy,
    opponent: Competitor | Policy,
    *,
    policies: ArrayLike,
    start: Starts,
    seed: int,
    candidates: bool = True,
) -> Recording:
    """Play one game as :func:`pcs_racing_agents.tournament.play_games` does, and record its race.

    Parameters
    ----------
    policies : array_like of int, shape (2,)
    start : Starts
        Of one game.
    seed : int
        Key of its noise.
    candidates : bool
        Whether to keep the candidate paths of each planner.
    """
    variants = np.asarray(policies)
    if variants.shape != (2,):
        raise InputError(f"policies have shape {variants.shape}; one game has two")
    cars = (as_competitor(ego), as_competitor(opponent))
    pairing = Pairing(game, *cars, variants[None], start, np.array([seed], np.uint64), 0)
    (columns,) = pairing.race([cars[0]])
    path = columns["path"][0]
    arena = game_between(game, *cars)
    # A step without a policy follows a crash; two drivers have none in any step, and drive in a single one.
    driven = int((path >= 0).any(axis=0).sum()) or 1
    theta = np.zeros((driven, 2, arena.setup.theta_size))
    for car, competitor in enumerate(cars):
        for step in range(driven):
            if isinstance(competitor, Driver):
                parameters = competitor.policies[variants[car]].parameters
            else:
                parameters = arena.archive.policy(int(path[car, step])).parameters
            theta[step, car, : len(parameters)] = parameters
    replay = record_drive(
        arena.setup,
        start,
        columns["noise"][0],
        theta,
        names=pairing.names,
        step_ticks=arena.config.step_ticks,
        candidates=candidates,
    )
    return Recording(replay, race_table(pairing, columns), arena)
