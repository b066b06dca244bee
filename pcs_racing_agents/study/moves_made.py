"""Which move the study's agents make in which situation: a part of their races, driven again to see what they saw."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.game.game import RaceGame
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.agent import Agent, Competitor, competitor_hash
from pcs_racing_agents.explain.explain import is_blind
from pcs_racing_agents.explain.situations import Situations, summarise, write_situations
from pcs_racing_agents.jobs.fingerprint import fingerprint
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.study.racing import StudyCell
from pcs_racing_agents.study.run import Study
from pcs_racing_agents.tournament.matches import play_games

__all__ = ["moves_in_situations"]

SEED = 7_000_000
BLOCK = 500  # races of one task


@dataclass(frozen=True, eq=False)
class _Task:
    """Races of a cell to be driven again; the digest is of all that their result depends on."""

    content_hash: str
    track: str
    arm: str
    opponent: str
    variants: NDArray[np.int64]
    starts: Starts
    seeds: NDArray[np.uint64]


@dataclass(frozen=True, eq=False)
class _Driver:
    """What drives them; it travels to other processes together with the games and the agents."""

    games: Mapping[str, RaceGame]
    agents: Mapping[str, Competitor]

    def __call__(self, task: _Task) -> dict[str, NDArray[Any]]:
        matches = play_games(
            self.games[task.track],
            self.agents[task.arm],
            self.agents[task.opponent],
            policies=task.variants,
            starts=task.starts,
            seeds=task.seeds,
        )
        return {"seen": matches.seen[:, 0], "moves": matches.moves[:, 0]}


def moves_in_situations(study: Study, played: Sequence[StudyCell], races: int = 1000) -> list[Situations]:
    """Sum up the moves of every agent of the main table that looks at the race; write each as CSV.

    Parameters
    ----------
    study : Study
    played : sequence of StudyCell
    races : int
        Of each cell, at most; drawn by the study's seed, the same ones for all agents.
    """
    agents = [name for name in study.config.arms if not is_blind(study.agent(name))]
    agents = [name for name in agents if isinstance(study.agent(name), Agent)]
    cells = [found for found in played if found.table == "main" and found.arm in agents]
    tasks = [task for found in cells for task in _tasks(study, found, races)]
    if not tasks:
        return []
    threads = None if study.executor is None else 1
    driver = _Driver(
        {name: replace(study.game(name), threads=threads) for name in {task.track for task in tasks}},
        {name: study.agent(name) for task in tasks for name in (task.arm, task.opponent)},
    )
    folder = study.folder / "report" / "situations"
    with open_job(folder, "situations", {"archive": study.archive.content_hash, "races": races}) as job:
        told = study.progress("tasks (moves in situations)")
        found = job.run("moves", driver, tasks, executor=study.executor, progress=told)
    summaries = []
    for name in agents:
        own = [arrays for task, arrays in zip(tasks, found, strict=True) if task.arm == name]
        seen, moves = (np.concatenate([arrays[key] for arrays in own]) for key in ("seen", "moves"))
        if (moves >= 0).any():
            summaries.append(summarise(seen, moves, study.archive, cells[0].cell.moves, name))
            write_situations(summaries[-1], _file(study.folder, name))
    return summaries


def _file(folder: Path, agent: str) -> Path:
    return folder / "report" / f"situations-{agent}.csv"


def _tasks(study: Study, found: StudyCell, races: int) -> list[_Task]:
    units = found.cell.units
    rng = np.random.default_rng(np.random.SeedSequence(study.config.seed, spawn_key=(SEED,)))
    chosen = np.sort(rng.permutation(len(units))[:races])
    who = [competitor_hash(study.agent(name)) for name in (found.arm, found.opponent)]
    track = study.track(found.track)
    tasks = []
    for first in range(0, len(chosen), BLOCK):
        rows = chosen[first : first + BLOCK]
        variants, starts, seeds = units.variants[rows], units.starts.take(rows), units.seeds[rows]
        drawn = (variants, starts.s, starts.side, seeds)
        digest = fingerprint(track.content_hash, study.archive.content_hash, study.config.game, who, drawn)
        tasks.append(_Task(digest, found.track, found.arm, found.opponent, variants, starts, seeds))
    return tasks
