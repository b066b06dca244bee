"""Which move the study's agents make in which situation: a part of their races, driven again to see what they saw."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing_agents.chunk_files import fingerprint
from pcs_racing_agents.explaining.explain import is_blind
from pcs_racing_agents.explaining.situations import Situations, summarise, write_situations
from pcs_racing_agents.jobs import open_job
from pcs_racing_agents.strategies.agent import Agent, competitor_hash
from pcs_racing_agents.study.racing import StudyCell
from pcs_racing_agents.study.run import Study
from pcs_racing_agents.tournament.matches import play_games

__all__ = ["moves_in_situations"]

SEED = 7_000_000
BLOCK = 500  # races of one task


@dataclass(frozen=True, eq=False)
class _Task:
    """Races of a cell to be driven again."""

    content_hash: str
    study: Study
    cell: StudyCell
    races: NDArray[np.intp]


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
    folder = study.folder / "report" / "situations"
    with open_job(folder, "situations", {"archive": study.archive.content_hash, "races": races}) as job:
        found = job.run("moves", _drive, tasks, progress=study.progress("tasks (moves in situations)"))
    summaries = []
    for name in agents:
        own = [arrays for task, arrays in zip(tasks, found, strict=True) if task.cell.arm == name]
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
        drawn = (units.variants[rows], units.starts.s[rows], units.starts.side[rows], units.seeds[rows])
        digest = fingerprint(track.content_hash, study.archive.content_hash, study.config.game, who, drawn)
        tasks.append(_Task(digest, study, found, rows))
    return tasks


def _drive(task: _Task) -> dict[str, NDArray[Any]]:
    study, found, rows = task.study, task.cell, task.races
    units = found.cell.units
    matches = play_games(
        study.game(found.track),
        study.agent(found.arm),
        study.agent(found.opponent),
        policies=units.variants[rows],
        starts=units.starts.take(rows),
        seeds=units.seeds[rows],
    )
    return {"seen": matches.seen[:, 0], "moves": matches.moves[:, 0]}
