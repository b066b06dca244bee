"""Game trees in a folder: built by a resumable job on any executor, and read one by one."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, check_whole, check_whole_array, is_whole
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.identity import GameIdentity
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.base.folders import read_job
from pcs_racing_agents.base.jobs import Arrays, Progress, chunk_file, open_job, read_chunk
from pcs_racing_agents.trees.build import (
    build_tree,
    check_game,
    choose_pairs,
    default_seeds,
    draw_root,
)
from pcs_racing_agents.trees.tree import RaceTree, tree_from_arrays

KIND = "game trees"
NAME = "tree"
MAKE_AGAIN = "rerun the command that made the folder"


@dataclass(frozen=True)
class _TreeTask:
    policies: NDArray[np.int64]
    index: int
    seeds: int
    seed: int


def _build(game: RaceGame, task: _TreeTask) -> Arrays:
    # The root depends on the tree's number, not on draws for other trees: missing trees are built
    # again alone.
    rng = np.random.default_rng(np.random.SeedSequence(task.seed, spawn_key=(1, task.index)))
    root = draw_root(game, task.policies, task.seeds, rng)
    return build_tree(game, root.policies, (root.start_s, root.side), root.seeds).arrays()


def build_trees(
    game: RaceGame,
    folder: str | Path,
    *,
    pairs: int | ArrayLike = 20,
    seeds_per_pair: int | None = None,
    seed: int = 0,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> "StoredTrees":
    """Build a game tree for each of several pairs of starting policies, and store them in a folder.

    In a folder of the same settings the work resumes: only missing and damaged trees are built.

    Parameters
    ----------
    folder : str or Path
        Folder that is new, empty, or from an earlier identical call.
    pairs : int or array of int, shape (N, 2)
        Starting policies, or the number of pairs to choose (:func:`choose_pairs`).
    seeds_per_pair : int, optional
        Number of noise seeds of each root, 1 to 1000; by default 4 with noise and 1 without noise.
    seed : int
        Root of all random draws. Tree ``i`` is a function of it and of ``i``.
    executor : concurrent.futures.Executor, optional
        Executor for the trees, each on one core; by default one tree after the other, each on all
        cores. It does not change the result.
    progress : callable, optional
        Called as ``progress(done, total, label)`` after every tree.
    """
    check_game(game)
    start_pairs = _checked_pairs(game.archive, pairs, seed)
    seeds = default_seeds(game) if seeds_per_pair is None else seeds_per_pair
    check_whole("seeds_per_pair", seeds, 1, 1000)
    if seeds > 1 and game.rules.steering_noise == 0.0:
        raise InputError(
            f"seeds_per_pair is {seeds}, but there is no steering noise: every seed drives the same"
        )
    settings = {
        **game_settings(game),
        "pairs": start_pairs,
        "seeds_per_pair": int(seeds),
        "seed": int(seed),
    }
    tasks = [_TreeTask(pair, i, int(seeds), int(seed)) for i, pair in enumerate(start_pairs)]
    build = partial(_build, game if executor is None else replace(game, threads=1))
    with open_job(folder, KIND, settings) as job:
        job.run(NAME, build, tasks, executor=executor, progress=progress, keep=False)
    return load_trees(folder)


def game_settings(game: RaceGame) -> dict[str, Any]:
    """Return the identity, the track and the rules of a game as plain values for a manifest."""
    identity = game.identity
    return {
        "archive": {"name": identity.archive, "sha256": identity.archive_sha256},
        "track": {"name": game.track.name, "sha256": game.track.content_hash},
        "rules": plain_settings(game.rules),
        "speed_range": [float(speed) for speed in game.setup.speed_range],
        "move_names": list(identity.moves),
        "encoding": list(identity.elements),
    }


def stored_identity(settings: Mapping[str, Any]) -> GameIdentity:
    """Return the identity of the game of stored trees, from :func:`game_settings`."""
    rules, archive = settings["rules"], settings["archive"]
    epsilon = rules["epsilon"]
    return GameIdentity(
        elements=tuple(settings["encoding"]),
        moves=tuple(settings["move_names"]),
        epsilon=tuple(epsilon) if isinstance(epsilon, list | tuple) else (epsilon,),
        archive=archive["name"],
        archive_sha256=archive["sha256"],
        rules=rules["name"],
        decisions=len(rules["steps"]) - 1,
    )


def _checked_pairs(archive: PolicyArchive, pairs: int | ArrayLike, seed: int) -> NDArray[np.int64]:
    if is_whole(pairs):
        return choose_pairs(archive, int(pairs), seed)
    array = check_whole_array("pairs", pairs, (None, 2), minimum=0, maximum=len(archive) - 1)
    if len(array) == 0:
        raise InputError("pairs are empty; give at least one")
    return array


@dataclass(frozen=True)
class StoredTrees(Sequence[RaceTree]):
    """Trees in a folder, each read on access."""

    folder: Path
    #: Settings of the job: the game (:func:`game_settings`), pairs and seeds.
    settings: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.settings["pairs"])

    def __repr__(self) -> str:
        """Show the folder, the archive and the track."""
        archive, track = (self.settings[key]["name"] for key in ("archive", "track"))
        return f"<StoredTrees: {len(self)} in {self.folder}, archive {archive!r}, track {track!r}>"

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the numbers of an observation."""
        return tuple(self.settings["encoding"])

    def file(self, index: int) -> Path:
        """Return the file of a tree."""
        return chunk_file(self.folder, NAME, index)

    def missing(self) -> list[int]:
        """Return the indices of the trees without a file."""
        return [i for i in range(len(self)) if not self.file(i).is_file()]

    @overload
    def __getitem__(self, index: int) -> RaceTree: ...
    @overload
    def __getitem__(self, index: slice) -> list[RaceTree]: ...
    def __getitem__(self, index: int | slice) -> RaceTree | list[RaceTree]:
        """Read one tree, or several."""
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        at = range(len(self))[index]
        file = self.file(at)
        tree = tree_from_arrays(_read(file), len(self.settings["rules"]["steps"]) - 1, str(file))
        if tree.policies.tolist() != list(self.settings["pairs"][at]):
            raise InputError(
                f"{file} is the tree of policies {tree.policies.tolist()}; it must be the tree of"
                f" {list(self.settings['pairs'][at])}: {MAKE_AGAIN}"
            )
        return tree

    def check(self, game: RaceGame) -> None:
        """Check that the trees belong to a game."""
        for key, wanted in game_settings(game).items():
            stored = self.settings.get(key)
            if stored != wanted:
                if isinstance(wanted, dict) and isinstance(stored, dict):
                    # `self` marks a missing entry: no value of a manifest is equal to it.
                    inner = next(
                        k
                        for k in {**stored, **wanted}
                        if stored.get(k, self) != wanted.get(k, self)
                    )
                    key, stored, wanted = f"{key} {inner}", stored.get(inner), wanted.get(inner)
                raise InputError(
                    f"the trees in {self.folder} are of another game: {key} is {stored!r}, not"
                    f" {wanted!r}"
                )


def _read(file: Path) -> Arrays:
    try:
        return read_chunk(file)
    except InputError as error:
        raise InputError(f"{error}; {MAKE_AGAIN}") from None


def load_trees(folder: str | Path, archive: PolicyArchive | None = None) -> StoredTrees:
    """Open a folder of trees, and check that they belong to the archive if one is given."""
    trees = StoredTrees(Path(folder), _read_settings(Path(folder) / "job.yaml"))
    archive_settings = trees.settings["archive"]
    if archive is not None and archive_settings["sha256"] != archive.content_hash:
        raise InputError(
            f"the trees in {folder} were played with archive {archive_settings['name']!r} (sha256"
            f" {archive_settings['sha256'][:12]}...), not with {archive.name!r}"
            f" ({archive.content_hash[:12]}...)"
        )
    missing = trees.missing()
    if missing:
        others = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise InputError(
            f"{trees.file(missing[0])}{others} missing of {len(trees)} trees: {MAKE_AGAIN}"
        )
    return trees


def _read_settings(file: Path) -> dict[str, Any]:
    """Read the settings of a job, after a check of the types of all used entries."""
    try:
        manifest = read_job(file)
    except OSError as error:
        raise InputError(f"{file.parent} holds no {KIND}: {file.name}: {error.strerror}") from None
    except InputError:
        manifest = None
    if (
        not isinstance(manifest, dict)
        or manifest.get("kind") != KIND
        or not isinstance(manifest.get("settings"), dict)
    ):
        raise InputError(
            f"{file} is no manifest of {KIND}; choose a folder that 'pcs-racing tree' wrote"
        )
    settings: dict[str, Any] = manifest["settings"]
    for key in ("archive", "track"):
        entry = settings.get(key)
        if not isinstance(entry, dict) or not all(
            isinstance(entry.get(name), str) for name in ("name", "sha256")
        ):
            raise InputError(
                f"{file}: {key} is {entry!r:.80}; it must have the texts name and sha256"
            )
    rules, pairs = settings.get("rules"), settings.get("pairs")
    steps = rules.get("steps") if isinstance(rules, dict) else None
    if not isinstance(steps, list) or not 2 <= len(steps) <= 101:
        raise InputError(f"{file}: rules are {rules!r:.80}; they must have steps, 2 to 101 lengths")
    if (
        not isinstance(pairs, list)
        or not pairs
        or not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs)
    ):
        raise InputError(
            f"{file}: pairs are {pairs!r:.80}; they must be a list of two policies each"
        )
    for key in ("encoding", "move_names"):
        if not isinstance(settings.get(key), list) or not all(
            isinstance(name, str) for name in settings[key]
        ):
            raise InputError(
                f"{file}: {key} is {settings.get(key)!r:.80}; it must be a list of texts"
            )
    return settings
