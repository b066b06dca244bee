"""Cells of a table: one ego against one kind of opponent, fully crossed; the cells of two egos pair up race by race.

A cell crosses start policies of the ego with variants of the opponent, start lines and sides: 20 x 20 x 5 x 2 = 4,000
games in the paper. Everything but the ego's decisions is the same in the cells of all egos against an opponent: start
policies, opponents, lines, sides and noise.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import Policy
from pcs_racing.race.races import start_lines
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.agent import Competitor, as_competitor
from pcs_racing_agents.jobs.jobs import Job, Progress
from pcs_racing_agents.tournament.matches import Matches, game_between, variant_count
from pcs_racing_agents.tournament.rows import RaceRow, pair_races
from pcs_racing_agents.tournament.runner import Pairing, each_pairing

__all__ = ["Cell", "CellPlan", "Units", "draw_units", "plan_cell", "play_cell", "play_cells"]

LINE_SETS = 8  # a circuit has so many times the start lines that a pair of variants meets on


@dataclass(frozen=True, eq=False)
class Units:
    """The races of a cell: every ego variant against every opponent variant, on every line, from both sides.

    Attributes
    ----------
    variants : ndarray, shape (U, 2), int64
        Variants of ego and opponent: policies of the archive to start with, or which of a driver's policies.
    line : ndarray, shape (U,), int64
        Number of the start line on the circuit.
    starts : Starts
        U of them.
    seeds : ndarray, shape (U,), uint64
        Keys of the noise.
    seed : int
        What they were drawn from.
    """

    variants: NDArray[np.int64]
    line: NDArray[np.int64]
    starts: Starts
    seeds: NDArray[np.uint64]
    seed: int

    def __len__(self) -> int:
        return len(self.line)

    @property
    def place(self) -> NDArray[np.int64]:
        """Labels of where the races start, shape (U,): several lines of a short circuit may lie in one place."""
        return np.unique(self.starts.s, return_inverse=True)[1].astype(np.int64)

    @property
    def ids(self) -> list[tuple[int, int, int, int]]:
        """What makes a race the same race in the cells of two egos: ego variant, opponent variant, line, side."""
        columns = (*self.variants.T.tolist(), self.line.tolist(), self.starts.side.tolist())
        return list(zip(*columns, strict=True))


@dataclass(frozen=True, eq=False)
class CellPlan:
    """A cell before it is played; made by :func:`plan_cell`.

    Attributes
    ----------
    arena : RaceGame
        The game in which the two meet.
    ego, opponent : Competitor
    units : Units
    """

    arena: RaceGame
    ego: Competitor
    opponent: Competitor
    units: Units

    @property
    def names(self) -> tuple[str, str]:
        """Names of ego and opponent."""
        first, second = (str(getattr(who, "name", type(who).__name__)) for who in (self.ego, self.opponent))
        return first, second


@dataclass(frozen=True, eq=False)
class Cell:
    """A cell that was played.

    Attributes
    ----------
    ego, opponent, track : str
        Names.
    units : Units
    matches : Matches
        What came of each of them.
    moves : tuple of str
        Names of the moves.
    """

    ego: str
    opponent: str
    track: str
    units: Units
    matches: Matches
    moves: tuple[str, ...]

    @property
    def score(self) -> NDArray[np.float64]:
        """Score of the ego in each race, shape (U,)."""
        return self.matches.score

    def rows(self) -> list[RaceRow]:
        """Return one line for every race."""
        units = self.units
        names = (self.ego, self.opponent)
        where = (self.track, units.seed, units.starts, units.variants)
        return list(pair_races(names, *where, self.matches, self.moves).rows())


def draw_units(
    game: RaceGame,
    ego: Competitor,
    opponent: Competitor,
    *,
    egos: int | Sequence[int] = 20,
    opponents: int | Sequence[int] = 20,
    lines: int = 5,
    seed: int = 0,
) -> Units:
    """Draw the races of a cell.

    Parameters
    ----------
    game : RaceGame
    ego, opponent : Competitor
        Only how many variants they have plays a role: the cells of all agents have the same units.
    egos, opponents : int or sequence of int
        How many variants, drawn without repetition (all of them, where there are no more); or which.
    lines : int
        Start lines of each pair of variants, 1 to 1000; drawn from eight times as many.
    seed : int

    Raises
    ------
    InputError
        If a number is impossible, a variant does not exist, or the track has no place to start.
    """
    arena = game_between(game, ego, opponent)
    if isinstance(lines, bool) or not isinstance(lines, int) or not 1 <= lines <= 1000:
        raise InputError(f"lines is {lines!r}; it must be a whole number from 1 to 1000")
    seeds = race_seeds(seed, 1)  # checks the seed
    first = _variants("egos", egos, variant_count(arena, ego), seed, 3)
    second = _variants("opponents", opponents, variant_count(arena, opponent), seed, 4)
    rules = replace(arena.setup.config, start_lines=lines * LINE_SETS)
    where = start_lines(arena.track, rules, np.random.SeedSequence(seed, spawn_key=(0,)))
    grid = np.meshgrid(first, second, np.arange(lines), np.arange(2), indexing="ij")
    a, b, own_line, side = (axis.reshape(-1).astype(np.int64) for axis in grid)
    pairs = len(first) * len(second)
    # Were the lines the same for all pairs, their luck would not average out, however many pairs there are.
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(5,)))
    rounds = [generator.permutation(lines * LINE_SETS) for _ in range(-(-pairs // LINE_SETS))]
    line = np.concatenate(rounds)[np.repeat(np.arange(pairs), 2 * lines) * lines + own_line]
    seeds = race_seeds(seed, len(line))
    return Units(np.stack([a, b], axis=1), line, Starts(where[line], side), seeds, int(seed))


def play_cell(
    game: RaceGame,
    ego: Competitor | Policy,
    opponent: Competitor | Policy,
    *,
    egos: int | Sequence[int] = 20,
    opponents: int | Sequence[int] = 20,
    lines: int = 5,
    seed: int = 0,
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Cell:
    """Play all games of one ego against one kind of opponent.

    Parameters
    ----------
    game : RaceGame
        Track, archive and rules.
    ego, opponent : Agent, Driver, Policy, or object with ``predict`` or ``decide``
        "never-switch" is the paper's non-GT agent, "random-policy" its random one, "lane-switcher" its unseen one.
    egos, opponents, lines, seed
        See :func:`draw_units`. The seed must be the same for cells that are to be compared.
    job : Job, optional
        Where results are kept; a cell that was played is not played again.
    executor : Executor, optional
        Where the games are played; by default here, on all cores.
    progress : callable, optional
        Told the number of games.

    Raises
    ------
    InputError
        If somebody does not fit the game, or a number is impossible.
    """
    plan = plan_cell(game, ego, opponent, egos=egos, opponents=opponents, lines=lines, seed=seed)
    name = "-".join((game.track.name, *plan.names))
    (cell,) = play_cells([plan], name=name, job=job, executor=executor, progress=progress)
    return cell


def plan_cell(
    game: RaceGame,
    ego: Competitor | Policy,
    opponent: Competitor | Policy,
    *,
    egos: int | Sequence[int] = 20,
    opponents: int | Sequence[int] = 20,
    lines: int = 5,
    seed: int = 0,
) -> CellPlan:
    """Check who is to race in a cell, and draw its races; see :func:`play_cell`.

    Raises
    ------
    InputError
        If somebody does not fit the game, or a number is impossible.
    """
    cars = (as_competitor(ego), as_competitor(opponent))
    units = draw_units(game, *cars, egos=egos, opponents=opponents, lines=lines, seed=seed)
    return CellPlan(game_between(game, *cars), *cars, units)


def play_cells(
    plans: Sequence[CellPlan],
    *,
    name: str = "cells",
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Iterator[Cell]:
    """Play several cells side by side, and yield them one by one.

    Parameters
    ----------
    plans : sequence of CellPlan
        All of one archive and one set of rules.
    name : str
        Of this part of the job's work.
    job, executor, progress
        As for :func:`play_cell`. With a job memory does not grow with the cells: they are read from its chunks.

    Raises
    ------
    InputError
        If the cells are of different games.
    """
    if not plans:
        return
    arena = plans[0].arena
    for plan in plans:
        if (plan.arena.config, plan.arena.archive.content_hash) != (arena.config, arena.archive.content_hash):
            raise InputError(
                f"the game on {plan.arena.track.name!r} has another archive or other rules than that on "
                f"{arena.track.name!r}; cells that are played together must be alike"
            )
    pairings = [
        Pairing(plan.arena.track, plan.ego, plan.opponent, plan.units.variants, plan.units.starts, plan.units.seeds)
        for plan in plans
    ]
    played = each_pairing(
        pairings, arena.archive, arena.config, name=name, job=job, executor=executor, progress=progress
    )
    for plan, matches in zip(plans, played, strict=True):
        yield Cell(*plan.names, plan.arena.track.name, plan.units, matches, plan.arena.move_names)


def _variants(what: str, wanted: int | Sequence[int], available: int, seed: int, stream: int) -> NDArray[np.int64]:
    if isinstance(wanted, int | np.integer) and not isinstance(wanted, bool):
        if wanted < 1:
            raise InputError(f"{what} is {wanted}; a cell needs at least one variant")
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream,)))
        return np.sort(generator.permutation(available)[: int(wanted)])
    chosen = np.asarray(wanted)
    if chosen.ndim != 1 or len(chosen) == 0 or chosen.dtype.kind not in "iu" or len(set(chosen.tolist())) < len(chosen):
        raise InputError(f"{what} is {wanted!r}; it must be a number of variants, or a list of different ones")
    if chosen.min() < 0 or chosen.max() >= available:
        raise InputError(f"{what} are {wanted!r}; there are variants 0 to {available - 1}")
    return chosen.astype(np.int64)
