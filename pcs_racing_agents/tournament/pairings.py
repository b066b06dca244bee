"""Pairings: sets of races of two competitors on one track, drawn in advance and repeatable.

Tournaments, tables of studies, training races and results folders consist of pairings. There are
two designs:

- scheduled (:func:`schedule_pairing`): race ``k`` has the same start line, side and noise for every
  pair on a track;
- crossed (:func:`cross_pairing`): start policies of the ego times variants of the opponent, start
  lines and sides (20 x 20 x 5 x 2 = 4,000 games in the paper). All egos against an opponent have
  the same start policies, opponent variants, lines, sides and noise; only the ego's decisions
  differ.

Simulation of pairings as tasks of a job, or of one race with recording.

Pairings with the same races against the same opponent are simulated together: common parts of their
egos' races are simulated only once (:mod:`pcs_racing_agents.tournament.games`).
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, check_seed, check_whole, check_whole_array, is_whole
from pcs_racing.game.players import Competitor, competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import Policy, PolicySet
from pcs_racing.planners.racers import own_name
from pcs_racing.race.config import Rules
from pcs_racing.race.races import draw_starts, race_keys, start_lines
from pcs_racing.race.recording import record_drive
from pcs_racing.race.replay import Replay
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.track import Track, calibration_values
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.base.jobs import Arrays, Job, Progress, Run, run_with_or_without
from pcs_racing_agents.tournament.games import game_between, race_columns, variant_count
from pcs_racing_agents.tournament.races import Categorical, RaceTable, narrow

MAX_RACES = 2000


class RaceSchedule(NamedTuple):
    """Races of one pair on one track, equal for all pairs (common random numbers)."""

    starts: Starts  #: N starts; races 2j and 2j + 1 use both sides of one start line.
    #: shape (N, 2): Random numbers that select the variants of ego and opponent. Races 2j and
    #: 2j + 1 swap them with the sides, so that both competitors have the advantage of a side
    #: equally often.
    draws: NDArray[np.uint64]
    seeds: NDArray[np.uint64]  #: shape (N,): Keys of the noise.

    def variants(self, ego: int, opponent: int) -> NDArray[np.int64]:
        """Return the variants in each race, shape (N, 2).

        ``ego``, ``opponent``: number of variants of each.
        """
        return (self.draws % np.array([ego, opponent], np.uint64)).astype(np.int64)


def draw_schedule(track: Track, config: Rules, races: int, seed: int) -> RaceSchedule:
    """Draw the races of each pair on a track.

    ``config``: rules, without an effect of ``start_lines``: every two races draw their own line.
    ``races``: even number from 2 to 2000.
    """
    if not is_whole(races) or races % 2 or not 2 <= races <= MAX_RACES:
        raise InputError(
            f"races_per_pair is {races!r}; it must be an even number from 2 to {MAX_RACES}, since"
            " every start line is driven from both sides"
        )
    starts = draw_starts(track, replace(config, start_lines=races // 2), races, seed)
    # The remainder of a large number selects a variant: a schedule is independent of competitors,
    # and pairs with equal numbers of variants have equal starts.
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2,)))
    draws = generator.integers(2**63, size=(races // 2, 2), dtype=np.uint64)
    swapped = np.stack([draws, draws[:, ::-1]], axis=1).reshape(races, 2)
    return RaceSchedule(starts, swapped, race_keys(config, seed, np.arange(races)))


LINE_SETS = 8  # start lines of a track, as a multiple of the lines of one pair of variants


@dataclass(frozen=True, eq=False)
class Pairing:
    """N races of two competitors on one track."""

    game: RaceGame  #: Track, archive and rules.
    ego: Competitor  #: ``ego``, ``opponent``: Competitors in car 0 and car 1.
    opponent: Competitor
    #: shape (N, 2): Index of each start policy in the archive, or of a planner's policy.
    variants: NDArray[np.int64]
    starts: Starts  #: N starts.
    noise: NDArray[np.uint64]  #: shape (N,): Keys of the races' noise.
    seed: int = 0  #: Seed of all these draws.

    def __post_init__(self) -> None:
        count = len(self.starts)
        shapes = self.variants.shape, self.noise.shape
        # No conversion to integers: policies such as 2.7 or True would change silently.
        if shapes != ((count, 2), (count,)) or self.variants.dtype.kind not in "iu":
            raise InputError(
                f"there are {count} starts, variants of shape {shapes[0]} and noise of shape"
                f" {shapes[1]}; they must be whole numbers of shape ({count}, 2) and ({count},)"
            )

    def __len__(self) -> int:
        return len(self.noise)

    @property
    def names(self) -> tuple[str, str]:
        """Names of ego and opponent."""
        return own_name(self.ego), own_name(self.opponent)

    def take(self, rows: ArrayLike) -> "Pairing":
        """Return the races with these indices."""
        indices = np.asarray(rows)
        return replace(
            self,
            variants=self.variants[indices],
            starts=self.starts.take(indices),
            noise=self.noise[indices],
        )

    def race(self, egos: Sequence[Competitor]) -> list[Arrays]:
        """Simulate the races with each of several egos.

        See :func:`pcs_racing_agents.tournament.games.race_columns`.
        """
        return race_columns(self.game, egos, self.opponent, self.variants, self.starts, self.noise)


class RaceBlock(NamedTuple):
    """Block of races of a group of pairings that differ only in their egos."""

    content_hash: str  #: Hash of all inputs of the result.
    group: int  #: Index of the group.
    first: int  #: ``first``, ``last``: Half-open range of each pairing's races, without ``last``.
    last: int


def race_block(groups: Sequence[Sequence[Pairing]], observations: bool, block: RaceBlock) -> Arrays:
    """Simulate a block of races; return arrays by name with the egos as first axis.

    ``observations``: True to return observations, too.
    """
    group = groups[block.group]
    raced = (
        group[0].take(np.arange(block.first, block.last)).race([pairing.ego for pairing in group])
    )
    left_out = {"noise"} if observations else {"noise", "observations"}
    return {
        name: np.stack([own[name] for own in raced]) for name in raced[0] if name not in left_out
    }


def schedule_pairing(
    game: RaceGame, ego: Competitor, opponent: Competitor, schedule: RaceSchedule, seed: int
) -> Pairing:
    """Return the races of a schedule for two competitors; ``seed`` is the schedule's seed."""
    variants = schedule.variants(variant_count(game, ego), variant_count(game, opponent))
    return Pairing(game, ego, opponent, variants, schedule.starts, schedule.seeds, seed)


def cross_pairing(
    game: RaceGame,
    ego: Competitor | Policy,
    opponent: Competitor | Policy,
    *,
    egos: int | Sequence[int] = 20,
    opponents: int | Sequence[int] = 20,
    lines: int = 5,
    seed: int = 0,
) -> Pairing:
    """Draw races of all ego variants against all opponent variants, on several lines, both sides.

    Parameters
    ----------
    ego, opponent : Agent, Driver, Policy, or object with ``act`` or ``predict``
        Competitors in car 0 and car 1. In the paper "never-switch" is the non-GT agent,
        "random-policy" the random agent, "lane-switcher:any" the held-out agent. The draws
        depend on the numbers of variants alone: all agents drive the same races.
    egos, opponents : int or sequence of int
        Number of variants, drawn without repetition (at most all variants), or a list of variants.
    lines : int
        Start lines of each pair of variants, 1 to 1000; drawn from eight times as many lines.
    seed : int
        Seed of the draws; it must be equal for compared pairings.
    """
    cars = (competitor(ego, game), competitor(opponent, game))
    meeting = game_between(game, *cars)
    check_whole("lines", lines, 1, 1000)
    # Check the seed before any draw, with the error message of the function that uses it.
    check_seed(seed)
    first = _variants("egos", egos, variant_count(meeting, cars[0]), seed, 3)
    second = _variants("opponents", opponents, variant_count(meeting, cars[1]), seed, 4)
    rules = replace(meeting.setup.rules, start_lines=lines * LINE_SETS)
    positions = start_lines(meeting.track, rules, np.random.SeedSequence(seed, spawn_key=(0,)))
    # The side is the fastest axis: races 2j and 2j + 1 are both sides of one line, as in schedules.
    grid = np.meshgrid(first, second, np.arange(lines), np.arange(2), indexing="ij")
    a, b, own_line, side = (axis.reshape(-1).astype(np.int64) for axis in grid)
    pairs = len(first) * len(second)
    # With equal lines for all pairs, the effect of the lines would not average out over pairs.
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(5,)))
    rounds = [generator.permutation(lines * LINE_SETS) for _ in range(-(-pairs // LINE_SETS))]
    line = np.concatenate(rounds)[np.repeat(np.arange(pairs), 2 * lines) * lines + own_line]
    return Pairing(
        game,
        *cars,
        np.stack([a, b], axis=1),
        Starts(positions[line], side),
        race_keys(game.rules, seed, np.arange(len(line))),
        int(seed),
    )


def _variants(
    noun: str, requested: int | Sequence[int], available: int, seed: int, stream: int
) -> NDArray[np.int64]:
    # Streams 0, 3, 4 and 5 are the draws of a pairing: the opponents don't depend on the number of
    # egos.
    if is_whole(requested):
        if requested < 1:
            raise InputError(f"{noun} is {requested}; a pairing needs at least one variant")
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream,)))
        return np.sort(generator.permutation(available)[: int(requested)])
    indices = check_whole_array(noun, requested, (None,), minimum=0, maximum=available - 1)
    if len(indices) == 0 or len(np.unique(indices)) < len(indices):
        raise InputError(
            f"{noun} is {requested!r}; it must be a number of variants, or a list of different ones"
        )
    return indices


BLOCK = 400  # races of one task: about a second of work


class Recording(NamedTuple):
    """A recorded game."""

    replay: Replay
    played: RaceTable  #: Result of the one game, with the observations of both cars.
    game: RaceGame  #: Played game, with the planners of both cars.


def repeat_race(pairing: Pairing, race: int, *, candidates: bool = True) -> Recording:
    """Simulate one race of a pairing in this process, and record it.

    ``race``: index of the race. ``candidates``: True to record the candidate paths of each planner.
    """
    if not 0 <= race < len(pairing):
        raise InputError(
            f"there is no race {race} in this pairing; there are races 0 to {len(pairing) - 1}"
        )
    one, cars = pairing.take([race]), (pairing.ego, pairing.opponent)
    (columns,) = one.race([pairing.ego])
    path = columns["path"][0]
    game = game_between(pairing.game, *cars)
    # A step without an archive policy follows a crash. Two planners have no archive policies, and
    # drive a single step.
    driven = int((path >= 0).any(axis=0).sum()) or 1
    theta = np.zeros((driven, 2, game.setup.theta_size))
    for car, player in enumerate(cars):
        for step in range(driven):
            if isinstance(player, PolicySet):
                parameters = player.policies[one.variants[0, car]].parameters
            else:
                parameters = game.archive.policy(int(path[car, step])).parameters
            theta[step, car, : len(parameters)] = parameters
    replay = record_drive(
        game.setup,
        one.starts,
        columns["noise"][0],
        theta,
        names=pairing.names,
        ends=game.rules.end_ticks[: driven - 1].tolist(),
        candidates=candidates,
    )
    return Recording(replay, race_table(one, columns), game)


def play_pairing(pairing: Pairing, *, observations: bool = False, **run: Unpack[Run]) -> RaceTable:
    """Simulate the races of one pairing; see :func:`play_pairings`."""
    name = "-".join((pairing.game.track.name, *pairing.names))
    (races,) = play_pairings([pairing], name=name, observations=observations, **run)
    return races


def play_pairings(
    pairings: Sequence[Pairing],
    *,
    name: str = "races",
    observations: bool = False,
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> list[RaceTable]:
    """Simulate the races of several pairings in parallel, and return the results of each pairing.

    Parameters
    ----------
    observations : bool
        True to record the last observations of both cars.
    progress : callable, optional
        Called as ``progress(done, total, name)``, counting races.
    """
    # Workers of an executor share the cores; without an executor a game uses all of them. Pairings
    # of one game still share it, so that its track is sent to a worker only once.
    games = {
        id(p.game): p.game if executor is None else replace(p.game, threads=1) for p in pairings
    }
    places = _groups(pairings)
    groups = [
        [replace(pairings[i], game=games[id(pairings[i].game)]) for i in group] for group in places
    ]
    blocks = [
        block
        for i, g in enumerate(groups)
        for block in _blocks(i, g, observations, hashed=job is not None)
    ]
    total = sum(len(pairing) for pairing in pairings)

    def report(done: int, tasks: int, label: str) -> None:
        if progress is not None:
            progress(round(total * done / tasks) if tasks else 0, total, label)

    # Names of tracks and agents are arbitrary; names of a job's chunks are not.
    chunk_name = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:80] or "races"
    worker = partial(race_block, groups, observations)
    results = run_with_or_without(
        chunk_name, worker, blocks, job=job, executor=executor, progress=report
    )
    tables: dict[int, RaceTable] = {}
    for number, members in enumerate(places):
        parts = [
            arrays for block, arrays in zip(blocks, results, strict=True) if block.group == number
        ]
        for k, i in enumerate(members):
            columns = {
                column: np.concatenate([part[column][k] for part in parts]) for column in parts[0]
            }
            tables[i] = race_table(pairings[i], columns)
    return [tables[i] for i in range(len(pairings))]


def race_table(pairing: Pairing, columns: Mapping[str, NDArray[Any]]) -> RaceTable:
    """Return the race table of a pairing, from its draws and its results (:meth:`Pairing.race`)."""
    count = len(pairing)
    return RaceTable(
        rules=Categorical.constant(pairing.game.rules.name, count),
        agents=Categorical.concatenate(
            [Categorical.constant(name, count) for name in pairing.names], axis=1
        ),
        track=Categorical.constant(pairing.game.track.name, count),
        race=narrow(np.arange(count)),
        start_s=pairing.starts.s,
        side=narrow(pairing.starts.side),
        seed=Categorical.constant(str(pairing.seed), count),
        lead=columns["lead"],
        winner=columns["winner"],
        crash=columns["crash"],
        fault=columns["fault"],
        overtakes=columns["overtakes"],
        duration=columns["duration"],
        variants=narrow(pairing.variants),
        path=columns["path"],
        moves=Categorical(pairing.game.moves, columns["moves"]),
        best_laps=columns["best_laps"],
        observations=columns.get("observations"),
    )


def _groups(pairings: Sequence[Pairing]) -> list[list[int]]:
    """Return groups of pairing indices.

    Pairings of a group differ only in their egos. A pairing with a planner as ego is its own group.
    """
    groups: dict[Any, list[int]] = {}
    for i, pairing in enumerate(pairings):
        draws = (pairing.variants, pairing.starts.s, pairing.starts.side, pairing.noise)
        # By identity, since a comparison of equal games would compare their maps.
        same: Any = (id(pairing.game), id(pairing.opponent), *(array.tobytes() for array in draws))
        groups.setdefault(i if isinstance(pairing.ego, PolicySet) else same, []).append(i)
    return list(groups.values())


def _blocks(
    number: int, group: Sequence[Pairing], observations: bool, *, hashed: bool
) -> Iterator[RaceBlock]:
    pairing, game = group[0], group[0].game
    common = ""
    if hashed:
        # Hashes serve only to look up stored results of a job; some competitors have no hash.
        hashes = [competitor_hash(car) for car in (*(each.ego for each in group), pairing.opponent)]
        calibration = {
            name: calibration_values(own) for name, own in game.track.calibration.items()
        }
        track = fingerprint(game.track.content_hash, calibration)
        common = fingerprint(track, game.archive.content_hash, game.rules, hashes, observations)
    # The size counts all egos, although they share races: in the worst case they part at move 1.
    size = max(1, BLOCK // len(group))
    for first in range(0, len(pairing), size):
        last = min(first + size, len(pairing))
        rows = slice(first, last)
        draws = (
            pairing.variants[rows],
            pairing.starts.s[rows],
            pairing.starts.side[rows],
            pairing.noise[rows],
        )
        yield RaceBlock(fingerprint(common, draws) if hashed else "", number, first, last)
