"""Explanation of one race: an agent's observation, values of the moves, and choice at each move.

The race is repeated bit by bit.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.observation import LEAD_SCALE
from pcs_racing.game.players import Competitor, ConstantPlayer
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import PolicySet
from pcs_racing.race.replay import Replay, ReplayEvent
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.blind import OpenLoopStrategy, WalkStrategy
from pcs_racing_agents.agents.observing import earlier, lead, opponent, own
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.tournament import Pairing, RaceTable, repeat_race

Floats = NDArray[np.float64]


class Unit(NamedTuple):
    """The unit of a network's values."""

    scale: float  #: Factor from a difference of two values to the unit.
    text: str  #: Name of the unit, such as ``"of a win"``; ``""`` for relative values.


class ExplainedDecision(NamedTuple):
    """A decision: the observation, values and move of the explained car."""

    time: float  #: Time since the start, s.
    own: Floats  #: shape (G,): Normalised coordinates of the own policy, from the archive.
    #: shape (G,): Normalised coordinates of the opponent: the agent's measurement of the last step.
    opponent: Floats
    lead: float  #: Own lead, m.
    move: int  #: Index of the chosen move.
    policy: int  #: ``policy``, ``next_policy``: Own policy before and after the move.
    next_policy: int
    probabilities: Floats | None  #: shape (M,): Probabilities of the moves, if known.
    values: Floats | None  #: shape (V,): Values of the first V moves, in units of the network.
    opponent_move: int  #: Index of the opponent's move; -1 for a planner.


@dataclass(frozen=True, eq=False)
class Explanation:
    """A race with the decisions of one of its agents."""

    archive: PolicyArchive
    moves: tuple[str, ...]  #: Names of the M moves.
    names: tuple[str, str]  #: Names of the competitors in car 0 and car 1.
    car: int  #: Index of the explained car.
    race: str  #: Name of the rules.
    ends: tuple[float, ...]  #: End of each step, s; moves take place at all ends but the last.
    steps: tuple[ExplainedDecision, ...]  #: Decisions, one per move; fewer after a crash.
    replay: Replay  #: Replay of the race, with the moves as events.
    played: RaceTable  #: Result of the race (one game).
    unit: Unit | None  #: Unit of the values.
    open_loop: bool  #: True if the agent is known to ignore the opponent.

    @property
    def middle(self) -> Floats:
        """Median of the archive's normalised coordinates, shape (G,): reference of adjectives."""
        return np.median(self.archive.normalised, axis=0)

    @property
    def lead(self) -> Floats:
        """Own lead at every frame of the replay, m."""
        return self.replay.lead if self.car == 0 else -self.replay.lead


def explain_race(pairing: Pairing, race: int, *, car: int = 0) -> Explanation:
    """Repeat a race of a pairing and explain the moves of one car, 0 or 1."""
    cars = (pairing.ego, pairing.opponent)
    competitor = cars[car]
    if isinstance(competitor, PolicySet):
        other = (
            "nor does the other car's"
            if isinstance(cars[1 - car], PolicySet)
            else "try the other car"
        )
        raise InputError(
            f"{competitor.name!r} in car {car} makes no moves, so there is nothing to explain;"
            f" {other}"
        )
    recording = repeat_race(pairing, race, candidates=False)
    played, game = recording.played, recording.game
    names = recording.replay.car_names
    config, strategy = game.config, getattr(competitor, "strategy", None)
    # A strategy may have a network of another kind, without values of moves.
    network = getattr(strategy, "network", None)
    network = network if isinstance(network, RegretNetwork) else None
    return Explanation(
        archive=game.archive,
        moves=game.move_names,
        names=(names[0], names[1]),
        car=car,
        race=config.race.name,
        ends=config.ends,
        steps=_steps(game, competitor, played, car, network),
        replay=mark_moves(recording.replay, played, game.move_names, config.ends),
        played=played,
        unit=None if network is None else value_unit(network, str(config.utility)),
        open_loop=is_open_loop(competitor),
    )


def _steps(
    game: RaceGame,
    competitor: Competitor,
    played: RaceTable,
    car: int,
    network: RegretNetwork | None,
) -> tuple[ExplainedDecision, ...]:
    axes = len(game.characteristics)
    steps = []
    for k in range(int((played.moves.codes[0, car] >= 0).sum())):
        # The last observation holds all earlier observations: cut it at this move.
        observation = earlier(played.observations[:, car], axes, k)
        steps.append(
            ExplainedDecision(
                time=game.config.ends[k],
                own=own(observation, axes)[0].astype(np.float64),
                opponent=opponent(observation, axes)[0].astype(np.float64),
                lead=LEAD_SCALE * float(lead(observation, axes)[0]),
                move=int(played.moves.codes[0, car, k]),
                policy=int(played.path[0, car, k]),
                next_policy=int(played.path[0, car, k + 1]),
                probabilities=(
                    competitor.probabilities(observation)[0]
                    if isinstance(competitor, Agent)
                    else None
                ),
                values=(
                    None
                    if network is None
                    else network.unclipped(observation)[0].astype(np.float64)
                ),
                opponent_move=int(played.moves.codes[0, 1 - car, k]),
            )
        )
    return tuple(steps)


def is_open_loop(competitor: Competitor) -> bool:
    """Return whether an agent's moves are known to depend only on time and its own policy."""
    strategy = getattr(competitor, "strategy", competitor)
    return isinstance(strategy, ConstantPlayer | OpenLoopStrategy | WalkStrategy)


def value_unit(network: RegretNetwork, utility: str) -> Unit:
    """Return the unit of a network's values.

    ``network``: the fact ``worth`` of its training decides ("win": shares of races won), else its
    target and the utility. ``utility``: one of :data:`pcs_racing.game.config.UTILITIES`.
    """
    if network.training.get("worth") == "win":
        return Unit(1.0, "of a win")
    if network.target in ("advantage", "static-q"):
        # A race won instead of lost is a difference of 2 in this utility.
        return Unit(0.5, "of a win") if utility == "win" else Unit(1.0, "m of lead")
    return Unit(1.0, "")


def mark_moves(
    replay: Replay, played: RaceTable, moves: tuple[str, ...], ends: tuple[float, ...]
) -> Replay:
    """Return a replay with the moves of both cars as events."""
    events = [
        ReplayEvent(ends[k], car, "move", moves[played.moves.codes[0, car, k]])
        for car in range(2)
        for k in range(played.moves.codes.shape[2])
        if played.moves.codes[0, car, k] >= 0
    ]
    ordered = sorted((*replay.events, *events), key=lambda event: event.time)
    return replace(replay, events=tuple(ordered))
