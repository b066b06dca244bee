"""One race explained: what an agent saw before each of its moves, what the moves were worth to it, and what it did.

The race is driven again, to the last bit; nothing is guessed from its outcome.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.observation import LEAD_SCALE
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import Policy
from pcs_racing.race.replay import Replay, ReplayEvent
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.agent import Agent, Competitor, Driver, as_competitor
from pcs_racing_agents.agents.blind import ConstantStrategy, OpenLoopStrategy, WalkStrategy
from pcs_racing_agents.agents.from_network import AdaptiveStrategy
from pcs_racing_agents.agents.observing import earlier, opponent, own
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.tournament.matches import Matches, game_between
from pcs_racing_agents.tournament.watching import record_match

__all__ = ["Explanation", "Habit", "Step", "Unit", "explain_match", "is_blind", "lead_seen", "mark_moves", "value_unit"]

Floats = NDArray[np.float64]


class Unit(NamedTuple):
    """What the values of a network are counted in.

    Attributes
    ----------
    scale : float
        Multiplies a difference of two values.
    text : str
        What to say after it, such as ``"of a win"``; ``""`` where a value means nothing by itself.
    """

    scale: float
    text: str


class Habit(NamedTuple):
    """What an agent does unless something else promises clearly more.

    Attributes
    ----------
    name : str
        The strategy that it keeps to.
    margin : float
        How much more a move must promise, in units of the network's values.
    """

    name: str
    margin: float


class Step(NamedTuple):
    """A moment at which both cars chose a move.

    Attributes
    ----------
    time : float
        Since the start, s.
    own : ndarray, shape (G,)
        Normalised coordinates of the own policy, from the archive.
    opponent : ndarray, shape (G,)
        Normalised coordinates of the opponent as measured in the step before: what the agent knew of it.
    lead : float
        Own lead, m.
    move : int
        Index of the move made.
    policy, next_policy : int
        Own policy before and after it.
    chances : ndarray, shape (M,), optional
        Chances of the moves, where the agent tells.
    values : ndarray, shape (V,), optional
        What each of the first V moves is worth, in units of the agent's network, where it has one.
    usual : int, optional
        The move of its habit, where it has one.
    opponent_move : int
        -1 for a driver.
    """

    time: float
    own: Floats
    opponent: Floats
    lead: float
    move: int
    policy: int
    next_policy: int
    chances: Floats | None
    values: Floats | None
    usual: int | None
    opponent_move: int


@dataclass(frozen=True, eq=False)
class Explanation:
    """A race, seen by one of its agents.

    Attributes
    ----------
    archive : PolicyArchive
    moves : tuple of str
        Names of the M moves.
    names : tuple of two str
        Who drove car 0 and car 1.
    car : int
        Whose moves are explained.
    race : str
        Name of the rules.
    step_seconds : float
        Time between two moves, s.
    steps : tuple of Step
        One for each move that was made; fewer after a crash.
    replay : Replay
        The race, with the moves as events.
    match : Matches
        What came of it; of one game.
    unit : Unit, optional
        Of the values.
    habit : Habit, optional
    blind : bool
        Whether the agent is known never to look at the opponent.
    """

    archive: PolicyArchive
    moves: tuple[str, ...]
    names: tuple[str, str]
    car: int
    race: str
    step_seconds: float
    steps: tuple[Step, ...]
    replay: Replay
    match: Matches
    unit: Unit | None
    habit: Habit | None
    blind: bool

    @property
    def middle(self) -> Floats:
        """Median of the archive's normalised coordinates, shape (G,): what "restrained" is said in relation to."""
        return np.median(self.archive.normalised, axis=0)

    @property
    def lead(self) -> Floats:
        """Own lead at every frame of the replay, m."""
        return self.replay.lead if self.car == 0 else -self.replay.lead


def explain_match(
    game: RaceGame,
    ego: Competitor | Policy,
    rival: Competitor | Policy,
    *,
    policies: ArrayLike,
    start: Starts,
    seed: int,
    car: int = 0,
    candidates: bool = False,
) -> Explanation:
    """Drive a game again and explain the moves of one car.

    Parameters
    ----------
    game : RaceGame
    ego, rival : Competitor or Policy
        Who drives car 0 and car 1.
    policies, start, seed, candidates
        As for :func:`pcs_racing_agents.tournament.watching.record_match`.
    car : int
        Whose moves to explain, 0 or 1.

    Raises
    ------
    InputError
        If that car's driver makes no moves, or as ``record_match``.
    """
    if car not in (0, 1):
        raise InputError(f"car is {car!r}; it must be 0 or 1")
    cars = (as_competitor(ego), as_competitor(rival))
    who = cars[car]
    if isinstance(who, Driver):
        raise InputError(f"{who.name!r} in car {car} makes no moves, so there is nothing to explain; try the other car")
    recording = record_match(game, *cars, policies=policies, start=start, seed=seed, candidates=candidates)
    match, arena = recording.match, game_between(game, *cars)
    names = recording.replay.car_names
    config, strategy = arena.config, getattr(who, "strategy", None)
    network = getattr(strategy, "network", None)
    network = network if isinstance(network, RegretNetwork) else None
    return Explanation(
        archive=arena.archive,
        moves=arena.move_names,
        names=(names[0], names[1]),
        car=car,
        race=config.race.name,
        step_seconds=config.step_seconds,
        steps=_steps(arena, who, match, car, network),
        replay=mark_moves(recording.replay, match, arena.move_names, config.step_seconds),
        match=match,
        unit=None if network is None else value_unit(network, str(config.utility)),
        habit=Habit(strategy.blind.name, strategy.margin) if isinstance(strategy, AdaptiveStrategy) else None,
        blind=is_blind(who),
    )


def _steps(
    arena: RaceGame, who: Competitor, match: Matches, car: int, network: RegretNetwork | None
) -> tuple[Step, ...]:
    axes = len(arena.characteristics)
    strategy = getattr(who, "strategy", None)
    steps = []
    for k in range(int((match.moves[0, car] >= 0).sum())):
        seen = earlier(match.seen[:, car], axes, k)
        usual = None
        if isinstance(strategy, AdaptiveStrategy):
            usual = int(strategy.blind.predict(seen[0])[0])
        steps.append(
            Step(
                time=(k + 1) * arena.config.step_seconds,
                own=own(seen, axes)[0].astype(np.float64),
                opponent=opponent(seen, axes)[0].astype(np.float64),
                lead=float(lead_seen(seen, axes, k)[0]),
                move=int(match.moves[0, car, k]),
                policy=int(match.policy[0, car, k]),
                next_policy=int(match.policy[0, car, k + 1]),
                chances=who.probabilities(seen)[0] if isinstance(who, Agent) else None,
                values=None if network is None else network.unclipped(seen)[0].astype(np.float64),
                usual=usual,
                opponent_move=int(match.moves[0, 1 - car, k]),
            )
        )
    return tuple(steps)


def lead_seen(observation: NDArray[np.float32], axes: int, step: int) -> Floats:
    """Own lead at the end of a step as an observation holds it, m, shape (B,); at most 100 m either way."""
    return LEAD_SCALE * observation[:, step * (2 * axes + 2) + 2 * axes].astype(np.float64)


def is_blind(who: Competitor) -> bool:
    """Whether an agent's moves are known not to depend on anything but time and its own policy."""
    return isinstance(getattr(who, "strategy", None), ConstantStrategy | OpenLoopStrategy | WalkStrategy)


def value_unit(network: RegretNetwork, utility: str) -> Unit:
    """Return what a network's values are counted in.

    Parameters
    ----------
    network : RegretNetwork
        Its training may say what an outcome was ``worth`` ("win": shares of races won); else what its target is made of
        decides, in games of this utility.
    utility : str
        One of :data:`pcs_racing.UTILITIES`.
    """
    if network.training.get("worth") == "win":
        return Unit(1.0, "of a win")
    if network.target in ("advantage", "static-q"):
        # A race won instead of lost is a difference of 2 in this utility.
        return Unit(0.5, "of a win") if utility == "win" else Unit(1.0, "m of lead")
    return Unit(1.0, "")


def mark_moves(replay: Replay, match: Matches, moves: tuple[str, ...], step_seconds: float) -> Replay:
    """Return a replay with the moves of both cars as events."""
    made = [
        ReplayEvent((k + 1) * step_seconds, car, "move", moves[match.moves[0, car, k]])
        for car in range(2)
        for k in range(match.moves.shape[2])
        if match.moves[0, car, k] >= 0
    ]
    return replace(replay, events=(*replay.events, *made))
