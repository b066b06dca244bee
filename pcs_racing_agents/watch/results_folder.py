"""The results folder of a tournament or study, for repeating its races.

A folder describes the competitors, starts and noise of its races. The hash of an agent detects a
changed agent, the lead of a race a changed result.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.config import GameConfig
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.config import RaceConfig
from pcs_racing.track.loading import load_track
from pcs_racing_agents.agents.agent import Competitor, competitor_hash
from pcs_racing_agents.agents.game_spec import GameSpec, make_game_spec
from pcs_racing_agents.agents.zoo import parse_agent
from pcs_racing_agents.base.folders import read_job
from pcs_racing_agents.tournament.pairings import (
    Pairing,
    cross_pairing,
    draw_schedule,
    schedule_pairing,
)
from pcs_racing_agents.tournament.races import RaceRow, RaceTable

MANIFEST = "job.yaml"


class RacedStudy(Protocol):
    """Archive, rules, games and agents of a study (:class:`pcs_racing_agents.study.study.Study`)."""

    @property
    def archive(self) -> PolicyArchive:
        """Archive of the agents' policies."""

    @property
    def spec(self) -> GameSpec:
        """Archive and rules of the games."""

    def game(self, track: str) -> RaceGame:
        """Return the game on a track."""

    def agent(self, name: str) -> Competitor:
        """Return an agent by name."""


@dataclass(frozen=True, eq=False)
class ResultsFolder:
    """A folder of races."""

    folder: Path
    settings: Mapping[str, Any]  #: Settings of a tournament, from ``job.yaml``.
    races: RaceTable  #: Content of ``results.csv``.
    study: RacedStudy | None  #: Study of the races; its agents replace the zoo's agents.
    tournament: bool  #: True for a tournament, False for the races of a study's tables.
    code: Sequence[str] = ()  #: Names of agents that may be code, to be run.

    def row(self, number: int) -> RaceRow:
        """Return a line of the results, counted from 0."""
        if not 0 <= number < len(self.races):
            raise InputError(
                f"there is no race {number} in {self.folder}; it holds races 0 to"
                f" {len(self.races) - 1}"
            )
        return self.races[number]

    def check_raced(self, agent: str) -> None:
        """Check that the results contain an agent."""
        if agent not in self.races.agents.words:
            raise InputError(
                f"{agent!r} did not race in {self.folder}; there are"
                f" {', '.join(sorted(self.races.agents.words))}"
            )

    def check_lead(self, number: int, lead: float) -> None:
        """Check that a repeated race ended with the lead in the results, to four digits."""
        recorded = f"{self.row(number).lead:.4f}"
        if f"{lead:.4f}" != recorded:
            raise InputError(
                f"race {number} came out otherwise than in {self.folder}: a lead of {lead:.4f} m"
                f" instead of {recorded} m; it was driven by another version"
            )

    @cached_property
    def pairs(self) -> dict[tuple[str, str, str, str], NDArray[np.intp]]:
        """Numbers of the races by track, pair and seed."""
        return self.races.pairs

    def pairing(self, row: RaceRow) -> Pairing:
        """Return the pairing of a line; ``row.race`` is the line's number in the pairing."""
        try:
            if self.study is not None and not self.tournament:
                return self._of_study(self.study, row)
            return self._of_tournament(row.track, row.ego, row.opponent)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            # InputErrors are ValueErrors, too, and more specific than a damaged manifest.
            if isinstance(error, InputError):
                raise
            raise InputError(f"{self.folder / MANIFEST} is damaged: {error!r}") from None

    def pairings(self, agent: str) -> Iterator[tuple[Pairing, int]]:
        """Yield all pairings of an agent, with the agent's car."""
        self.check_raced(agent)
        firsts = [self.races[int(numbers[0])] for numbers in self.pairs.values()]
        rows = [row for row in firsts if agent in (row.ego, row.opponent)]
        for row in rows:
            for car, name in enumerate((row.ego, row.opponent)):
                if name == agent:
                    yield self.pairing(row), car

    def _of_study(self, study: RacedStudy, row: RaceRow) -> Pairing:
        # All races of a pairing together determine its variants and number of lines.
        rows = self.pairs[row.track, row.ego, row.opponent, str(row.seed)]
        egos, opponents = (np.unique(self.races.variants[rows, car]).tolist() for car in range(2))
        lines = len(rows) // max(1, 2 * len(egos) * len(opponents))
        game, cars = study.game(row.track), (study.agent(row.ego), study.agent(row.opponent))
        return cross_pairing(
            game, *cars, egos=egos, opponents=opponents, lines=lines, seed=row.seed
        )

    def _of_tournament(self, track: str, ego: str, opponent: str) -> Pairing:
        settings, study = self.settings, self.study
        # All inputs of a race are compared by hash: other inputs give another race.
        archive = load_archive(settings["archive"]) if study is None else study.archive
        _check_same(f"archive {archive.name!r}", archive.content_hash, settings["archive_sha256"])
        circuit = load_track(track)
        _check_same(f"track {track!r}", circuit.content_hash, settings["tracks"][track])
        seed = int(settings["seed"])
        spec = make_game_spec(archive, _game_config(settings["game"]))
        cars = []
        for name in (ego, opponent):
            car = (
                parse_agent(name, spec, seed=seed, code=name in self.code)
                if study is None
                else study.agent(name)
            )
            _check_same(f"agent {name!r}", competitor_hash(car), settings["agents"][name])
            cars.append(car)
        game = RaceGame(circuit, spec.archive, spec.config)
        schedule = draw_schedule(
            circuit, spec.config.race_rules, int(settings["races_per_pair"]), seed
        )
        return schedule_pairing(game, cars[0], cars[1], schedule, seed)


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Return the manifest of a job's folder, if any."""
    file = folder / MANIFEST
    try:
        manifest = read_job(file)
    except FileNotFoundError:
        return None
    except (OSError, InputError) as error:
        raise InputError(f"{file} is damaged: {error}") from None
    if (
        not isinstance(manifest, dict)
        or not isinstance(manifest.get("settings"), dict)
        or "kind" not in manifest
    ):
        raise InputError(f"{file} is no manifest of a job")
    return manifest


def _game_config(values: Mapping[str, Any]) -> GameConfig:
    """Return the rules in a manifest, without the move "stay": every tournament adds it."""
    return GameConfig(
        **{**tuples(values), "race": RaceConfig(**tuples(values["race"])), "stay": None}
    )


def tuples(values: Any) -> dict[str, Any]:
    """Return settings of a manifest with tuples in place of lists."""
    if not isinstance(values, Mapping):
        raise InputError(f"{MANIFEST} holds {values!r:.80} where settings should be")
    return {
        key: tuple(value) if isinstance(value, list) else value for key, value in values.items()
    }


def _check_same(noun: str, current: str, recorded: str) -> None:
    if current != recorded:
        raise InputError(
            f"{noun} has changed since the races were driven (sha256 {current[:12]}, it was"
            f" {str(recorded)[:12]}), so they can't be driven again"
        )
