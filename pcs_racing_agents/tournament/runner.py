"""Simulation of pairings as tasks of a job, or of one race with recording.

Pairings with the same races against the same opponent are simulated together: common parts of their
egos' races are simulated only once (:mod:`pcs_racing_agents.tournament.games`).
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import PolicySet
from pcs_racing.race.recording import record_drive
from pcs_racing.race.replay import Replay
from pcs_racing.track.track import calibration_values
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.base.jobs import Job, Run, run_with_or_without
from pcs_racing_agents.base.progress import Progress
from pcs_racing_agents.tournament.games import game_between
from pcs_racing_agents.tournament.pairings import Pairing, RaceBlock, race_block
from pcs_racing_agents.tournament.races import Categorical, RaceTable, narrow

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
    for car, competitor in enumerate(cars):
        for step in range(driven):
            if isinstance(competitor, PolicySet):
                parameters = competitor.policies[one.variants[0, car]].parameters
            else:
                parameters = game.archive.policy(int(path[car, step])).parameters
            theta[step, car, : len(parameters)] = parameters
    replay = record_drive(
        game.setup,
        one.starts,
        columns["noise"][0],
        theta,
        names=pairing.names,
        ends=game.config.end_ticks[: driven - 1].tolist(),
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
    count, config = len(pairing), pairing.game.config
    return RaceTable(
        preset=Categorical.constant(config.race.name, count),
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
            preset: calibration_values(own) for preset, own in game.track.calibration.items()
        }
        track = fingerprint(game.track.content_hash, calibration)
        common = fingerprint(track, game.archive.content_hash, game.config, hashes, observations)
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
