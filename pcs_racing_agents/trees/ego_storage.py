"""Ego trees in a folder: built by a resumable job on any executor."""

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.jobs.chunks import chunk_file, read_chunk
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.progress import Progress
from pcs_racing_agents.trees.ego import MOST_ROOTS, EgoTrees, check_ego, join_ego, play_ego
from pcs_racing_agents.trees.storage import MAKE_AGAIN, game_settings, read_settings

KIND = "ego trees"
NAME = "ego"
ROOTS = 32  # of a chunk


@dataclass(frozen=True)
class _EgoTask:
    first: int
    roots: int
    opponent: str
    seed: int


@dataclass(frozen=True)
class _Player:
    """The function of a task; it is pickled together with the game."""

    game: RaceGame

    def __call__(self, task: _EgoTask) -> dict[str, NDArray[Any]]:
        trees = play_ego(self.game, task.roots, opponent=task.opponent, seed=task.seed, first=task.first)
        return trees.arrays()


def build_ego_trees(
    game: RaceGame,
    folder: str | Path,
    *,
    roots: int = 320,
    opponent: str = "random",
    seed: int = 0,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> EgoTrees:
    """Build ego trees and store them in a folder; in a folder of the same settings the work resumes.

    Parameters
    ----------
    folder : str or Path
        New, empty, or left by the same call.
    roots, opponent, seed
        As for :func:`play_ego`; the roots are the same ones.
    executor : concurrent.futures.Executor, optional
        Where they are played, 32 at a time, each on one core; by default one after the other, each on all cores. It
        does not change the result.
    progress : callable, optional
        Called as ``progress(done, total, label)`` after every 32 roots.
    """
    check_ego(game, roots, opponent, seed)
    settings = {**game_settings(game), "roots": int(roots), "opponent": opponent, "seed": int(seed)}
    tasks = [
        _EgoTask(first, min(ROOTS, int(roots) - first), opponent, int(seed)) for first in range(0, int(roots), ROOTS)
    ]
    player = _Player(game if executor is None else replace(game, threads=1))
    with open_job(folder, KIND, settings) as job:
        job.run(NAME, player, tasks, executor=executor, progress=progress, keep=False)
    return load_ego_trees(folder)


def load_ego_trees(folder: str | Path) -> EgoTrees:
    """Read all ego trees of a folder."""
    roots = read_settings(folder, KIND).get("roots")
    if type(roots) is not int or not 1 <= roots <= MOST_ROOTS:
        raise InputError(
            f"{Path(folder) / 'job.yaml'}: roots are {roots!r:.80}; they must be a whole number from 1 to {MOST_ROOTS}"
        )
    batches: list[EgoTrees] = []
    for i in range(-(-roots // ROOTS)):
        file = chunk_file(folder, NAME, i)
        try:
            arrays = read_chunk(file)
        except InputError as error:
            raise InputError(f"{error}; {MAKE_AGAIN}") from None
        batch = EgoTrees.from_arrays(arrays, str(file))
        wanted = min(ROOTS, roots - i * ROOTS)
        if len(batch) != wanted:
            raise InputError(f"{file} holds {len(batch)} roots; there should be {wanted}: {MAKE_AGAIN}")
        if batches and (batch.moves, batch.options, batch.own[0].shape[2]) != (
            batches[0].moves,
            batches[0].options,
            batches[0].own[0].shape[2],
        ):
            raise InputError(f"{file} holds {batch!r}, the files before {batches[0]!r}: {MAKE_AGAIN}")
        batches.append(batch)
    return join_ego(batches)
