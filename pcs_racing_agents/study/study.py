"""A study: its configuration and folder, as the context of its stages.

Reader of the results of a tournament or study, to repeat and watch their races.

A folder describes the competitors, starts and noise of its races. The hash of an agent detects a
changed agent, the lead of a race a changed result.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.make import make_game
from pcs_racing.game.players import Competitor, competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.config import Rules
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.agent import Agent, competitor_hash
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.base.folders import read_job
from pcs_racing_agents.base.jobs import Progress, show_progress
from pcs_racing_agents.study.config import BASELINES, StudyConfig, load_study_config
from pcs_racing_agents.tournament import (
    Pairing,
    RaceRow,
    RaceTable,
    cross_pairing,
    draw_schedule,
    read_results,
    schedule_pairing,
)
from pcs_racing_agents.watch.results_folder import MANIFEST, ResultsFolder

NETWORKS = {
    "cfr-argmax": "regret",
    "cfr-regret-matching": "regret",
    "nash": "nash",
}
"""Kinds of networks of the zoo's agents."""


@dataclass(frozen=True)
class Study:
    """A study with its configuration and folder."""

    config: StudyConfig
    folder: Path
    executor: Executor | None = None  #: Executor of the jobs.
    quiet: bool = False  #: No progress output.

    @cached_property
    def archive(self) -> PolicyArchive:
        """Policy archive."""
        return load_archive(self.config.archive)

    @cached_property
    def spec(self) -> RaceGame:
        """Archive and rules, in the form for agents."""
        return make_game(None, self.archive, self.config.rules)

    def game(self, track: Track | str) -> RaceGame:
        """Return the game on a track."""
        return make_game(track, self.archive, self.config.rules)

    def games(self) -> list[RaceGame]:
        """Return the games on the training tracks."""
        return [self.game(track) for track in self.config.learning.tracks]

    def network(self, kind: str) -> Path:
        """Return the folder of a network (or set of networks) trained by this study."""
        return self.folder / "networks" / kind

    def fit(self, baseline: str) -> Path:
        """Return the file of a baseline fitted by this study."""
        return self.folder / "open-loop" / f"{baseline}.yaml"

    def table_seeds(self, table: int) -> range:
        """Return the seeds of the races of a table, one for each opponent."""
        first = self.config.seed + 100 * table
        return range(first, first + 100)

    def agent(self, name: str) -> Competitor:
        """Return an agent or planner by name, with this study's networks and fits.

        The names are the zoo's names and the names in the configuration's ``responses``.
        """
        seed, learning = self.config.seed, self.config.learning
        if name in learning.responses:
            agent = build("cfr-argmax", self.spec, seed=seed, network=self.network(name))
            assert isinstance(agent, Agent)
            return replace(agent, name=name)
        if name in BASELINES:
            return build(name, self.spec, seed=seed, fit=self.fit(name))
        # Networks of this study replace shipped networks.
        if NETWORKS.get(name) in learning.networks:
            return build(name, self.spec, seed=seed, network=self.network(NETWORKS[name]))
        return competitor(name, self.spec, seed=seed)

    def progress(self, unit: str) -> Progress | None:
        """Return a progress function that updates a line on stderr; None if ``quiet``."""
        return None if self.quiet else show_progress(unit)


def open_results(
    folder: str | Path, code: Sequence[str] = (), maps: Sequence[str] = ()
) -> ResultsFolder:
    """Open a tournament's or study's folder.

    Agents named in ``code`` may be code, which is run. ``maps`` are the folders of maps that were
    moved since the races were driven.
    """
    path = Path(folder)
    kind, settings = _read_manifest(path)
    file = path / "results.csv"
    if not file.exists():
        raise InputError(f"there is no {file}; it is written when all races are driven")
    races = read_results(file)
    moved = {load_track(place).name: place for place in maps}
    for names, known in ((code, races.agents.words), (moved, races.track.words)):
        for name in names:
            if name not in known:
                raise InputError(
                    f"{name!r} is not in the races of {folder}; there are"
                    f" {', '.join(sorted(known))}"
                )
    make: Callable[[RaceRow], Pairing]
    try:
        if kind == "study":
            study = Study(load_study_config(**settings), path, quiet=True)
            rules, make = study.config.rules, partial(study_pairing, study, races, moved=moved)
        else:
            rules = Rules(**settings["rules"])
            make = partial(_tournament_pairing, settings, rules, code, moved)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path / MANIFEST} is damaged: {error}") from None
    return ResultsFolder(path, file, races, rules.start, make)


def _read_manifest(folder: Path) -> tuple[str, dict[str, Any]]:
    """Return the kind and the settings of a folder of results."""
    file = folder / MANIFEST
    try:
        manifest = read_job(file) if file.is_file() else {"kind": None, "settings": {}}
        kind, settings = manifest["kind"], dict(manifest["settings"])
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{file} is damaged: {error}") from None
    if kind not in ("tournament", "study"):
        raise InputError(
            f"{folder} holds no races; give a folder that 'pcs-racing tournament' or 'pcs-racing"
            " study' wrote with --out"
        )
    return kind, settings


def study_pairing(
    study: Study, races: RaceTable, row: RaceRow, moved: Mapping[str, str] = MappingProxyType({})
) -> Pairing:
    """Return the pairing of one of the races of a study; ``moved``: places of maps by name."""
    # All races of a pairing together determine its variants and number of lines.
    rows = races.pairs[row.track, row.ego, row.opponent, str(row.seed)]
    egos, opponents = (np.unique(races.variants[rows, car]).tolist() for car in range(2))
    places = [moved[row.track]] if row.track in moved else study.config.tracks
    tracks = {track.name: track for track in map(_load_track, places)}
    return cross_pairing(
        study.game(tracks[row.track]),
        study.agent(row.ego),
        study.agent(row.opponent),
        egos=egos,
        opponents=opponents,
        lines=len(rows) // max(1, 2 * len(egos) * len(opponents)),
        seed=row.seed,
    )


def _load_track(place: str) -> Track:
    try:
        return load_track(place)
    except InputError as error:
        raise InputError(f"{error}; if the map was moved, --track names its folder") from None


def _tournament_pairing(
    settings: Mapping[str, Any],
    rules: Rules,
    code: Sequence[str],
    moved: Mapping[str, str],
    row: RaceRow,
) -> Pairing:
    """Return the pairing of one of the races of a tournament.

    All inputs are compared by hash: other inputs give another race.
    """
    seed, spec = int(settings["seed"]), make_game(None, settings["archive"], rules)
    archive = spec.archive
    _check_same(f"archive {archive.name!r}", archive.content_hash, settings["archive_sha256"])
    track = _load_track({**settings.get("maps", {}), **moved}.get(row.track, row.track))
    _check_same(f"track {row.track!r}", track.content_hash, settings["tracks"][row.track])

    def agent(name: str) -> Competitor:
        car = competitor(name, spec, seed=seed, code=name in code)
        _check_same(f"agent {name!r}", competitor_hash(car), settings["agents"][name])
        return car

    races = int(settings["races_per_pair"])
    schedule = draw_schedule(track, spec.rules.for_game, races, seed)
    game = replace(spec, track=track)
    return schedule_pairing(game, agent(row.ego), agent(row.opponent), schedule, seed)


def _check_same(noun: str, current: str, recorded: str) -> None:
    if current != recorded:
        raise InputError(
            f"{noun} has changed since the races were driven (sha256 {current[:12]}, it was"
            f" {str(recorded)[:12]}), so they can't be driven again"
        )
