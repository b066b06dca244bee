"""Explanation of one race: an agent's observation, values of the moves, and choice at each move.

The race is repeated bit by bit.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.base.typing import Floats
from pcs_racing.game.observation import LEAD_SCALE
from pcs_racing.game.players import Competitor, ConstantPlayer
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import PolicySet
from pcs_racing.race.replay import Replay, ReplayEvent
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.blind import OpenLoopStrategy, WalkStrategy
from pcs_racing_agents.agents.observing import earlier, lead, opponent
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.tournament import Pairing, RaceTable, repeat_race


class ExplainedDecision(NamedTuple):
    """A decision: the observation, values and move of the explained car."""

    time: float  #: Time since the start, s.
    #: shape (G,): Normalised coordinates of the opponent: the agent's measurement of the last step.
    opponent: Floats
    lead: float  #: Own lead, m.
    move: int  #: Index of the chosen move.
    policy: int  #: ``policy``, ``next_policy``: Own policy before and after the move.
    next_policy: int
    probabilities: Floats | None  #: shape (M,): Probabilities of the moves, if known.
    values: Floats | None  #: shape (V,): Values of the first V moves, if known.


@dataclass(frozen=True, eq=False)
class Explanation:
    """A race with the decisions of one of its agents."""

    game: RaceGame
    car: int  #: Index of the explained car.
    steps: tuple[ExplainedDecision, ...]  #: Decisions, one per move; fewer after a crash.
    replay: Replay  #: Replay of the race, with the moves as events.
    played: RaceTable  #: Result of the race (one game).
    unit: str  #: Unit of the values, such as ``"of a win"``; empty for relative values.
    open_loop: bool  #: True if the agent is known to ignore the opponent.

    @property
    def middle(self) -> Floats:
        """Median of the archive's normalised coordinates, shape (G,): reference of adjectives."""
        return np.median(self.game.archive.normalised, axis=0)

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
    # A strategy may have a network of another kind, without values of moves.
    network = getattr(getattr(competitor, "strategy", None), "network", None)
    network = network if isinstance(network, RegretNetwork) else None
    scale, unit = (1.0, "") if network is None else value_unit(network, str(game.rules.utility))
    steps = []
    for k in range(int((played.moves.codes[0, car] >= 0).sum())):
        # The last observation holds all earlier observations: cut it at this move.
        axes = len(game.characteristics)
        seen = earlier(played.observations[:, car], axes, k)
        chances, values = None, None
        if isinstance(competitor, Agent | ConstantPlayer):
            chances = competitor.probabilities(seen)[0]
        if network is not None:
            values = scale * network.unclipped(seen)[0].astype(np.float64)
        steps.append(
            ExplainedDecision(
                time=game.rules.ends[k],
                opponent=opponent(seen, axes)[0].astype(np.float64),
                lead=LEAD_SCALE * float(lead(seen, axes)[0]),
                move=int(played.moves.codes[0, car, k]),
                policy=int(played.path[0, car, k]),
                next_policy=int(played.path[0, car, k + 1]),
                probabilities=chances,
                values=values,
            )
        )
    return Explanation(
        game=game,
        car=car,
        steps=tuple(steps),
        replay=mark_moves(recording.replay, played, game.moves, game.rules.ends),
        played=played,
        unit=unit,
        open_loop=is_open_loop(competitor),
    )


def is_open_loop(competitor: Competitor) -> bool:
    """Return whether an agent's moves are known to depend only on time and its own policy."""
    strategy = getattr(competitor, "strategy", competitor)
    return isinstance(strategy, ConstantPlayer | OpenLoopStrategy | WalkStrategy)


def value_unit(network: RegretNetwork, utility: str) -> tuple[float, str]:
    """Return the unit of a network's values: a factor to it, and its name (empty: relative).

    ``network``: the fact ``worth`` of its training decides ("win": shares of races won), else its
    target and the utility. ``utility``: one of :data:`pcs_racing.race.config.UTILITIES`.
    """
    if network.training.get("worth") == "win":
        return 1.0, "of a win"
    if network.target == "advantage":
        # A race won instead of lost is a difference of 2 in this utility.
        return (0.5, "of a win") if utility == "win" else (1.0, "m of lead")
    return 1.0, ""


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
