"""What policies are like: races against random opponents from random places, the same for every policy.

This is the ``eval`` of Algorithm 1: every policy meets every pairing of start position and opponent, from both sides
of the grid, on every track; starts, opponents and noise are drawn once per run, so that policies differ by what they do
and not by the luck of the draw.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.characteristics import Segment, get_characteristics, measure
from pcs_racing.planners.registry import get_planner
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.races import RaceSetup, advance, start_lines, start_races, winners
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.track import Track, load_track
from pcs_racing_agents.jobs.chunks import Arrays

__all__ = ["Block", "Evaluation", "Scenarios", "blocks", "draw_scenarios", "evaluate", "race_block", "summarise"]

Floats = NDArray[np.float64]

RACES_AT_ONCE = 4096  # bounded memory


@dataclass(frozen=True, eq=False)
class Scenarios:
    """The races that every policy drives: R of them.

    Attributes
    ----------
    tracks : tuple of Track or str
        Circuits, or their names or folders, which workers on other machines load themselves.
    config : RaceConfig
        Rules and duration.
    planner : str
        Of the policies and of their opponents.
    characteristics : tuple of str
    segment_seconds : float
        Length of the pieces that coordinates are means of, s.
    opponents : ndarray, shape (O, P)
        Parameters of the opponents.
    track : ndarray, shape (R,)
        Index of the circuit of each race, ascending.
    start_s : ndarray, shape (R,)
        Start line, m.
    side : ndarray, shape (R,)
        0 when the policy starts on the left or in front.
    seed : ndarray, shape (R,)
        Noise key.
    opponent : ndarray, shape (R,)
        Index of the opponent.
    """

    tracks: tuple[Track | str, ...]
    config: RaceConfig
    planner: str
    characteristics: tuple[str, ...]
    segment_seconds: float
    opponents: Floats
    track: NDArray[np.int64]
    start_s: Floats
    side: NDArray[np.int64]
    seed: NDArray[np.uint64]
    opponent: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.track)

    def against(self, opponents: Floats) -> "Scenarios":
        """Return the same races against other opponents, as many as before."""
        if opponents.shape != self.opponents.shape:
            raise InputError(f"opponents have shape {opponents.shape}; these races need {self.opponents.shape}")
        return replace(self, opponents=opponents)


class Evaluation(NamedTuple):
    """What came of racing K policies.

    Attributes
    ----------
    coordinates : ndarray, shape (K, G)
        Mean over all pieces of racing, in the characteristics' units.
    own_crash : ndarray, shape (K,)
        Share of the races that ended by a crash of the policy's own fault.
    spread : ndarray, shape (K, G)
        Standard error of the coordinates, were the races drawn again.
    """

    coordinates: Floats
    own_crash: Floats
    spread: Floats


class Block(NamedTuple):
    """Some policies and the races that they are to drive: a task for a worker.

    Attributes
    ----------
    scenarios : Scenarios
    parameters : ndarray, shape (k, P)
    """

    scenarios: Scenarios
    parameters: Floats


def draw_scenarios(
    tracks: Sequence[Track | str],
    config: RaceConfig,
    opponents: Floats,
    characteristics: Sequence[str],
    *,
    planner: str = "lattice",
    starts: int = 2,
    segment_seconds: float = 8.0,
    seed: int = 0,
) -> Scenarios:
    """Draw the races of a run: on every track, all pairs of ``starts`` start lines and all opponents, from both sides.

    Parameters
    ----------
    tracks : sequence of Track or str
    config : RaceConfig
    opponents : ndarray, shape (O, P)
    characteristics : sequence of str
    planner : str
    starts : int
        Start lines on each track, 1 to 1000.
    segment_seconds : float
        Length of a piece, s; the duration of the race must be a multiple.
    seed : int
        Root of start lines and noise.

    Returns
    -------
    Scenarios
        ``len(tracks) * starts * len(opponents) * 2`` races.

    Raises
    ------
    InputError
        If a number is impossible, a track has no place for the start, or the duration is no multiple of the pieces.
    """
    pieces = round(config.duration / segment_seconds) if segment_seconds > 0.0 else 0
    if pieces < 1 or abs(pieces * segment_seconds - config.duration) > 1e-9:
        raise InputError(f"a race of {config.duration:g} s is no multiple of segment_seconds, {segment_seconds:g} s")
    family = get_planner(planner)
    opponents = np.array(opponents, np.float64)
    if opponents.ndim != 2 or opponents.shape[1] != len(family.parameters) or len(opponents) == 0:
        raise InputError(
            f"opponents have shape {opponents.shape}; planner {planner!r} needs (any but 0, {len(family.parameters)})"
        )
    if len(tracks) == 0:
        raise InputError("there are no tracks; name at least one")
    get_characteristics(characteristics)
    rules = replace(config, start_lines=starts)
    line, opponent, side = (part.ravel() for part in np.mgrid[:starts, : len(opponents), :2])
    start_s, seeds = [], []
    for index, track in enumerate(tracks):
        root = np.random.SeedSequence(seed, spawn_key=(index,))
        lines, noise = root.spawn(2)
        start_s.append(start_lines(_loaded(track), rules, lines)[line])
        seeds.append(race_seeds(int(noise.generate_state(1, np.uint64)[0]), len(line)))
    return Scenarios(
        tracks=tuple(tracks),
        config=config,
        planner=planner,
        characteristics=tuple(characteristics),
        segment_seconds=float(segment_seconds),
        opponents=opponents,
        track=np.repeat(np.arange(len(tracks)), len(line)),
        start_s=np.concatenate(start_s),
        side=np.tile(side, len(tracks)),
        seed=np.concatenate(seeds),
        opponent=np.tile(opponent, len(tracks)),
    )


def _loaded(track: Track | str | Path) -> Track:
    return track if isinstance(track, Track) else load_track(track)


def race_block(block: Block, threads: int | None = None) -> Arrays:
    """Race some policies; the result does not depend on how policies are put into blocks.

    Returns
    -------
    dict of ndarray
        ``totals`` (k, R, G): sums over the pieces that each race began; ``pieces`` (k, R): how many it began;
        ``own_crash`` (k, R): whether it ended by a crash of the policy's own fault; ``crashed`` (k, R): whether it
        ended by a crash; ``winner`` (k, R): 0 the policy, 1 its opponent, -1 nobody.

    Raises
    ------
    InputError
        If a characteristic is not finite.
    """
    scenarios, parameters = block
    axes = get_characteristics(scenarios.characteristics)
    planner = get_planner(scenarios.planner)
    count, races = len(parameters), len(scenarios)
    totals = np.zeros((count, races, len(axes)))
    pieces, winner = np.zeros((count, races), np.int16), np.zeros((count, races), np.int8)
    own_crash, crashed = np.zeros((count, races), np.bool_), np.zeros((count, races), np.bool_)
    length = round(scenarios.segment_seconds * 100.0)
    for index, source in enumerate(scenarios.tracks):
        setup = RaceSetup(_loaded(source), scenarios.config, (planner, planner))
        here = np.flatnonzero(scenarios.track == index)
        step = max(1, RACES_AT_ONCE // len(here))
        for first in range(0, count, step):
            egos = np.arange(first, min(first + step, count))
            ego, which = (part.ravel() for part in np.meshgrid(egos, here, indexing="ij"))
            state = start_races(setup, Starts(scenarios.start_s[which], scenarios.side[which]), scenarios.seed[which])
            rivals = scenarios.opponents[scenarios.opponent[which]]
            theta = np.ascontiguousarray(np.stack([parameters[ego], rivals], axis=1))
            for _ in range(round(scenarios.config.duration / scenarios.segment_seconds)):
                before = state.copy()
                advance(setup, state, theta, length, threads=threads)
                piece = Segment.between(before, state, scenarios.segment_seconds)
                begun = piece.time > 0.0
                values = measure(piece, axes)[:, 0]
                if not np.isfinite(values[begun]).all():
                    row, axis = np.argwhere(~np.isfinite(values) & begun[:, None])[0]
                    raise InputError(
                        f"characteristic {axes[axis].name!r} is {values[row, axis]} in race {which[row]} of policy "
                        f"{ego[row]}; it must be finite"
                    )
                totals[ego, which] += np.where(begun[:, None], values, 0.0)
                pieces[ego, which] += begun
            own_crash[ego, which] = state.fault[:, 0] == 1
            crashed[ego, which] = state.crashed
            winner[ego, which] = winners(scenarios.config, state)
    return {"totals": totals, "pieces": pieces, "own_crash": own_crash, "crashed": crashed, "winner": winner}


def blocks(scenarios: Scenarios, parameters: Floats, size: int) -> list[Block]:
    """Cut policies into blocks of up to ``size``."""
    parameters = np.asarray(parameters, np.float64)
    return [Block(scenarios, parameters[first : first + size]) for first in range(0, len(parameters), size)]


def summarise(raced: Arrays) -> Evaluation:
    """Return means, shares and standard errors of what :func:`race_block` found.

    A coordinate is a ratio, the sum over all pieces by their number; its standard error follows from the residuals of
    the races (linearised; the pieces of a race count as one observation).
    """
    totals, pieces = raced["totals"], raced["pieces"].astype(np.float64)
    races = totals.shape[1]
    coordinates = totals.sum(axis=1) / pieces.sum(axis=1)[:, None]
    residuals = totals - coordinates[:, None] * pieces[..., None]
    spread = np.sqrt(races / max(races - 1, 1) * (residuals**2).sum(axis=1)) / pieces.sum(axis=1)[:, None]
    return Evaluation(coordinates, raced["own_crash"].mean(axis=1), spread)


def evaluate(
    scenarios: Scenarios,
    parameters: Floats,
    *,
    executor: Executor | None = None,
    block: int = 8,
) -> Evaluation:
    """Race every policy in every scenario.

    Parameters
    ----------
    scenarios : Scenarios
    parameters : ndarray, shape (K, P)
    executor : Executor, optional
        Where blocks of policies race; in this thread by default, which shares the races among the cores. It has no
        influence on the result.
    block : int
        Policies in a block.

    Returns
    -------
    Evaluation

    Raises
    ------
    InputError
        If the parameters have another shape than the planner's, or a characteristic is not finite.
    """
    parameters = np.asarray(parameters, np.float64)
    if parameters.ndim != 2 or parameters.shape[1] != scenarios.opponents.shape[1] or len(parameters) == 0:
        raise InputError(
            f"parameters have shape {parameters.shape}; planner {scenarios.planner!r} needs (any but 0, "
            f"{scenarios.opponents.shape[1]})"
        )
    cut = blocks(scenarios, parameters, block)
    if executor is None:
        return summarise(join([race_block(part) for part in cut]))
    return summarise(join(list(executor.map(race_here(executor), cut))))


def race_here(executor: Executor | None) -> Callable[[Block], Arrays]:
    """Return :func:`race_block` for workers: with one thread each where an executor runs several of them."""
    return race_block if executor is None else partial(race_block, threads=1)


def join(parts: Sequence[Arrays]) -> Arrays:
    """Put the results of blocks together."""
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
