"""Races to be driven again: from the folder of a tournament or study, or from the names of two agents.

What a folder holds says who raced whom, from where, and with which noise; an agent whose weights have changed since is
told apart by its digest, and a race that comes out otherwise by its lead.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.config import GameConfig
from pcs_racing.game.game import RaceGame
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.track import load_track
from pcs_racing_agents.agents.agent import Competitor, competitor_hash
from pcs_racing_agents.agents.setting import make_setting
from pcs_racing_agents.agents.zoo import parse_agent
from pcs_racing_agents.jobs.folders import read_job
from pcs_racing_agents.study.config import StudyConfig
from pcs_racing_agents.study.run import Study
from pcs_racing_agents.tournament.cells import draw_units
from pcs_racing_agents.tournament.matches import variant_count
from pcs_racing_agents.tournament.play import plan_tournament
from pcs_racing_agents.tournament.result_lines import ResultLines, read_lines
from pcs_racing_agents.tournament.schedule import Schedule, draw_schedule

__all__ = ["Contest", "Results", "open_results", "planned_contest"]

MANIFEST = "job.yaml"
CELL = ("track", "ego", "opponent", "seed")


class Contest(NamedTuple):
    """All races of two competitors on one track.

    Attributes
    ----------
    game : RaceGame
    ego, opponent : Competitor
        In car 0 and car 1.
    variants : ndarray, shape (N, 2), int64
    starts : Starts
    seeds : ndarray, shape (N,), uint64
    """

    game: RaceGame
    ego: Competitor
    opponent: Competitor
    variants: NDArray[np.int64]
    starts: Starts
    seeds: NDArray[np.uint64]


@dataclass(frozen=True, eq=False)
class Results:
    """The races of a folder.

    Attributes
    ----------
    folder : Path
    settings : Mapping
        What they depend on, out of ``job.yaml``; of a tournament.
    rows : ResultLines
        Lines of ``results.csv``.
    study : Study, optional
        The study that they belong to: its agents are not those of the zoo.
    tournament : bool
        Whether it was all against all; else they are the cells of a study.
    """

    folder: Path
    settings: Mapping[str, Any]
    rows: ResultLines
    study: Study | None
    tournament: bool

    def row(self, number: int) -> dict[str, str]:
        """Return a line of the results, counted from 0.

        Raises
        ------
        InputError
            If there is none.
        """
        if not 0 <= number < len(self.rows):
            raise InputError(f"there is no race {number} in {self.folder}; it holds races 0 to {len(self.rows) - 1}")
        return self.rows[number]

    @cached_property
    def cells(self) -> dict[tuple[str, ...], NDArray[np.intp]]:
        """Numbers of the lines by the pair, track and seed that they belong to, in the order of the file."""
        columns = [self.rows.columns[name] for name in CELL]
        places = np.array([column.places for column in columns])
        _, first, cell = np.unique(places, axis=1, return_index=True, return_inverse=True)
        cell = cell.reshape(-1)
        lines = np.split(np.argsort(cell, kind="stable"), np.cumsum(np.bincount(cell))[:-1])
        found = {}
        for k in np.argsort(first).tolist():
            found[tuple(column.words[column.places[first[k]]] for column in columns)] = lines[k]
        return found

    def contest(self, row: Mapping[str, str]) -> Contest:
        """Return all races of the pair, on the track and of the seed of a line; its ``race`` is its number in them.

        Raises
        ------
        InputError
            If the archive, the track or an agent is not what it was when the races were driven.
        """
        try:
            if self.study is not None and not self.tournament:
                return self._of_study(self.study, row)
            return self._of_tournament(row["track"], row["ego"], row["opponent"])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{self.folder / MANIFEST} is damaged: {error!r}") from None

    def contests(self, agent: str) -> Iterator[tuple[Contest, int]]:
        """Return all contests of an agent, with the car that it drove in them.

        Raises
        ------
        InputError
            If it did not race here, or as :meth:`contest`.
        """
        firsts = [self.rows[int(lines[0])] for lines in self.cells.values()]
        found = [row for row in firsts if agent in (row["ego"], row["opponent"])]
        if not found:
            names = sorted({row[car] for row in firsts for car in ("ego", "opponent")})
            raise InputError(f"{agent!r} did not race in {self.folder}; there are {', '.join(names)}")
        for row in found:
            for car, name in enumerate((row["ego"], row["opponent"])):
                if name == agent:
                    yield self.contest(row), car

    def _of_study(self, study: Study, row: Mapping[str, str]) -> Contest:
        """Cells have variants and lines of their own, which all their lines together tell."""
        cell = self.cells[tuple(row[key] for key in CELL)]
        variants = []
        for name in ("ego_variant", "opponent_variant"):
            words, places = self.rows.columns[name]
            variants.append(sorted({int(words[place]) for place in places[cell].tolist()}))
        lines = len(cell) // max(1, 2 * len(variants[0]) * len(variants[1]))
        game, cars = study.game(row["track"]), (study.agent(row["ego"]), study.agent(row["opponent"]))
        seed = int(row["seed"])
        units = draw_units(game, *cars, egos=variants[0], opponents=variants[1], lines=lines, seed=seed)
        return Contest(game, *cars, units.variants, units.starts, units.seeds)

    def _of_tournament(self, track: str, ego: str, opponent: str) -> Contest:
        settings, study = self.settings, self.study
        archive = load_archive(settings["archive"]) if study is None else study.archive
        _check_same(f"archive {archive.name!r}", archive.content_hash, settings["archive_sha256"])
        circuit = load_track(track)
        _check_same(f"track {track!r}", circuit.content_hash, settings["tracks"][track])
        seed = int(settings["seed"])
        setting = make_setting(archive, _game_config(settings["game"]))
        cars = []
        for name in (ego, opponent):
            car = parse_agent(name, setting, seed=seed) if study is None else study.agent(name)
            _check_same(f"agent {name!r}", competitor_hash(car), settings["agents"][name])
            cars.append(car)
        game = RaceGame(circuit, setting.archive, setting.config)
        schedule = draw_schedule(circuit, setting.config.race_rules, int(settings["races_per_pair"]), seed)
        return _scheduled(game, cars, schedule)


def open_results(folder: str | Path) -> Results:
    """Open the folder of a tournament or of a study.

    Raises
    ------
    InputError
        If it is neither, or holds no results.
    """
    place = Path(folder)
    manifest = _manifest(place)
    if manifest is None or manifest["kind"] not in ("tournament", "study"):
        raise InputError(
            f"{folder} holds no races; give a folder that 'pcs-racing tournament' or 'pcs-racing study' wrote with "
            "--out"
        )
    # A study keeps the races of its ratings in a folder of their own, and their lines beside it.
    file, study = place / "results.csv", None
    if manifest["kind"] == "study":
        study = Study(_study_config(manifest["settings"]), place, quiet=True)
    else:
        above = _manifest(place.resolve().parent)
        if above is not None and above["kind"] == "study":
            study = Study(_study_config(above["settings"]), place.resolve().parent, quiet=True)
            file = place.resolve().with_suffix(".csv")
    if not file.exists():
        raise InputError(f"there is no {file}; it is written when all races are driven")
    rows = read_lines(file)
    missing = {*CELL, "race", "lead", "ego_variant", "opponent_variant", "start_s"} - set(rows.columns)
    if missing or not len(rows):
        raise InputError(f"{file} holds no races{' with ' if missing else ''}{', '.join(sorted(missing))}")
    return Results(place, manifest["settings"], rows, study, manifest["kind"] == "tournament")


def planned_contest(
    names: Sequence[str], track: str, race: RaceConfig, *, archive: str, races: int, seed: int
) -> Contest:
    """Return the races that a tournament between two agents would drive.

    Raises
    ------
    InputError
        If something is unknown or does not fit.
    """
    plan = plan_tournament([load_track(track)], list(names), race, archive=archive, races_per_pair=races, seed=seed)
    setting = plan.setting
    game = RaceGame(plan.tracks[0], setting.archive, setting.config)
    return _scheduled(game, plan.competitors, plan.schedules[0])


def _scheduled(game: RaceGame, cars: Sequence[Competitor], schedule: Schedule) -> Contest:
    variants = schedule.variants(variant_count(game, cars[0]), variant_count(game, cars[1]))
    return Contest(game, cars[0], cars[1], variants, schedule.starts, schedule.seeds)


def _manifest(folder: Path) -> dict[str, Any] | None:
    """Return what a job's folder says about itself; None where there is no job."""
    file = folder / MANIFEST
    try:
        found = read_job(file)
    except FileNotFoundError:
        return None
    except (OSError, InputError) as error:
        raise InputError(f"{file} is damaged: {error}") from None
    if not isinstance(found, dict) or not isinstance(found.get("settings"), dict) or "kind" not in found:
        raise InputError(f"{file} is no manifest of a job")
    return found


def _study_config(values: Mapping[str, Any]) -> StudyConfig:
    try:
        return StudyConfig(**_tuples(values))
    except TypeError as error:
        raise InputError(f"the study's settings are of another version: {error}") from None


def _game_config(values: Mapping[str, Any]) -> GameConfig:
    """Rules out of a manifest; the move "stay" that every tournament adds is left to the race's own rules."""
    return GameConfig(**{**_tuples(values), "race": RaceConfig(**_tuples(values["race"])), "stay": None})


def _tuples(values: Any) -> dict[str, Any]:
    if not isinstance(values, Mapping):
        raise InputError(f"{MANIFEST} holds {values!r:.80} where settings should be")
    return {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}


def _check_same(what: str, found: str, wanted: str) -> None:
    if found != wanted:
        raise InputError(
            f"{what} has changed since the races were driven (sha256 {found[:12]}, it was {str(wanted)[:12]}), so they "
            "can't be driven again"
        )
