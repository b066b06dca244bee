"""What the synthesis of an archive depends on, as data."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.errors import ConfigError
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.planners.registry import get_planner
from pcs_racing.race.config import RaceConfig, load_race_config
from pcs_racing_agents.jobs.configuration import check_numbers, check_wholes, load_settings, shipped_configs
from pcs_racing_agents.synthesis.mo_cma_es import LOSSES, MEANS
from pcs_racing_agents.synthesis.optimisers import METHODS

__all__ = ["ArchiveConfig", "list_archive_configs", "load_archive_config"]

KIND = "archive"
SHIPPED_TRACKS = ("Tarnfjord", "Vellindra", "Kestrelheim")


@dataclass(frozen=True)
class ArchiveConfig:
    """How an archive is made: 2,000 policies and 48 races each by default.

    Attributes
    ----------
    name : str
        Of the archive.
    preset : str
        Rules of the races: a preset's name or a YAML file.
    duration, final_duration : float
        Length of a race while policies are searched and chosen, and when those chosen are measured, s; multiples of
        ``segment_seconds``.
    segment_seconds : float
        Length of the pieces that coordinates are means of, s: a step of the game.
    tracks : tuple of str
        Names or folders of the circuits, which all policies race on.
    planner : str
    characteristics : tuple of str
        Axes; by default aggressiveness (or pace, as the rules say) and restraint.
    method : {"mo-cma-es", "nsga2", "comocma", "cma-mae", "random"}
        Who proposes policies; the first is the paper's.
    generations : int
        0 to 100,000.
    population : int
        Policies of a generation, 2 to 10,000.
    elite_ratio : float
        Share of a generation that shapes the next one.
    loss, mean : str
        Reading of Algorithm 1 (:class:`~pcs_racing_agents.synthesis.synthesize.Search`).
    step_size : float
        First standard deviation of CMA-ES, as a share of the parameters' ranges.
    scouts : int
        Policies drawn at random before the first generation, 8 to 10,000. Their range is the scale of the axes in the
        loss and in the hypervolume, and the best of them are the first archive.
    opponents, starts : int
        Opponents (policies at random) and start lines on each track: every policy meets all pairs, from both sides.
    crash_limit : float
        Share of own crashes in races of ``final_duration`` beyond which a policy stays out of the archive; 1 keeps all.
        For the shorter races of the search it is converted as if crashes came at a constant rate.
    least : tuple of float, optional
        Smallest coordinates of interest, one for each axis: a policy below one of them stays out of the archive, like
        one that crashes too often. By default there is no such limit.
    candidates : int
        Policies that are raced again for the choice of the archive.
    choice_opponents, choice_starts : int
        Opponents and start lines of those races; other ones than in the search.
    error_bars : float
        A policy is beaten by another if that one is better on all axes by more than so many standard errors of the
        difference.
    spacing : float
        Distance that policies of the archive keep from each other, in units of the archive's ranges; of two that are
        nearer one is dropped.
    fewest, most : int
        Policies wanted in the archive; with more than ``most``, the spacing is widened.
    final_opponents, final_starts : int
        Opponents and start lines of the races that give the coordinates; new ones again.
    refresh_generations : tuple of int
        Generations before which some opponents are replaced by policies of the archive as it is then. The archive is
        raced again against them, and as many policies fewer are raced in the end.
    refresh_share : float
        Share of the opponents that is replaced, 0 to 1.
    seed : int
        Root of everything that is drawn.

    Raises
    ------
    ConfigError
        If a value is impossible.
    InputError
        If a name stands for nothing.
    """

    name: str = "archive"
    preset: str = "paper"
    duration: float = 16.0
    final_duration: float = 40.0
    segment_seconds: float = 8.0
    tracks: tuple[str, ...] = SHIPPED_TRACKS
    planner: str = "lattice"
    characteristics: tuple[str, ...] | None = None
    method: str = "mo-cma-es"
    generations: int = 60
    population: int = 32
    elite_ratio: float = 0.5
    loss: str = "uhvi"
    mean: str = "generation"
    step_size: float = 0.3
    scouts: int = 80
    opponents: int = 4
    starts: int = 2
    crash_limit: float = 0.15
    least: tuple[float, ...] | None = None
    candidates: int = 240
    choice_opponents: int = 8
    choice_starts: int = 2
    error_bars: float = 1.0
    spacing: float = 0.015
    fewest: int = 40
    most: int = 80
    final_opponents: int = 12
    final_starts: int = 3
    refresh_generations: tuple[int, ...] = ()
    refresh_share: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        for key in ("name", "preset", "planner", "method", "loss", "mean"):
            if not isinstance(getattr(self, key), str) or not getattr(self, key):
                raise ConfigError(f"{key} is {getattr(self, key)!r}; it must be a non-empty text")
        for key in ("tracks", "characteristics"):
            names = getattr(self, key)
            if (key == "tracks" or names is not None) and (
                not isinstance(names, tuple) or not names or not all(isinstance(name, str) for name in names)
            ):
                raise ConfigError(f"{key} is {names!r}; it must be a list of names")
        if len(set(self.tracks)) < len(self.tracks):
            raise ConfigError(f"tracks are {', '.join(self.tracks)}; name each once")
        for key, known in (("method", METHODS), ("loss", LOSSES), ("mean", MEANS)):
            if getattr(self, key) not in known:
                raise ConfigError(f"{key} is {getattr(self, key)!r}; it must be one of {', '.join(known)}")
        check_wholes(
            self,
            generations=(0, 100_000),
            population=(4, 10_000),
            scouts=(8, 10_000),
            opponents=(1, 1000),
            starts=(1, 1000),
            candidates=(2, 10_000),
            choice_opponents=(1, 1000),
            choice_starts=(1, 1000),
            fewest=(1, 10_000),
            most=(2, 10_000),
            final_opponents=(1, 1000),
            final_starts=(1, 1000),
            seed=(0, 2**63 - 1),
        )
        check_numbers(
            self,
            duration=(0.1, 3600.0),
            final_duration=(0.1, 3600.0),
            segment_seconds=(0.1, 3600.0),
            elite_ratio=(0.01, 1.0),
            step_size=(1e-6, 1.0),
            crash_limit=(0.0, 1.0),
            error_bars=(0.0, 10.0),
            spacing=(0.0, 0.5),
            refresh_share=(0.0, 1.0),
        )
        for key in ("duration", "final_duration"):
            length = getattr(self, key)
            pieces = round(length / self.segment_seconds)
            if pieces < 1 or abs(pieces * self.segment_seconds - length) > 1e-9:
                raise ConfigError(
                    f"{key} is {length:g} s; it must be a multiple of segment_seconds, {self.segment_seconds:g} s"
                )
        if self.fewest > self.most:
            raise ConfigError(f"fewest is {self.fewest}, above most, {self.most}")
        stated = self.refresh_generations
        whole = isinstance(stated, tuple) and all(type(generation) is int for generation in stated)
        if (
            not whole
            or any(not 0 < generation < self.generations for generation in stated)
            or len(set(stated)) < len(stated)
        ):
            raise ConfigError(
                f"refresh_generations is {stated!r}; it must be a list of different generations from 1 to "
                f"{self.generations - 1}"
            )
        object.__setattr__(self, "refresh_generations", tuple(sorted(stated)))
        get_planner(self.planner)
        get_characteristics(self.axes)
        if self.least is not None:
            numbers = [type(value) in (int, float) and abs(value) < np.inf for value in self.least]
            if not isinstance(self.least, tuple) or len(numbers) != len(self.axes) or not all(numbers):
                raise ConfigError(
                    f"least is {self.least!r}; it must be a list of numbers, one for each of {', '.join(self.axes)}"
                )

    @property
    def rules(self) -> RaceConfig:
        """Rules of the races, with the duration of those of the search."""
        return load_race_config(self.preset, duration=float(self.duration))

    @property
    def search_crash_limit(self) -> float:
        """The crash limit for races of the search."""
        return float(1.0 - (1.0 - self.crash_limit) ** (self.duration / self.final_duration))

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the characteristics."""
        if self.characteristics is not None:
            return self.characteristics
        return "pace" if self.rules.aggressiveness == "pace" else "aggressiveness", "restraint"

    @property
    def evaluations(self) -> int:
        """Policies that the search races at most, scouts included."""
        return self.scouts + self.generations * self.population

    @property
    def races(self) -> int:
        """Races of each policy during the search."""
        return len(self.tracks) * self.opponents * self.starts * 2

    @property
    def work(self) -> tuple[float, float, float]:
        """Seconds of racing in the search, the choice and the measurement, at most."""
        races = 2 * len(self.tracks)
        return (
            self.evaluations * self.races * self.duration,
            self.candidates * races * self.choice_opponents * self.choice_starts * self.duration,
            self.most * races * self.final_opponents * self.final_starts * self.final_duration,
        )


def list_archive_configs() -> list[str]:
    """Names of the configurations that come with the package."""
    return list(shipped_configs(KIND))


def load_archive_config(source: str | Path | ArchiveConfig | None = None, **changes: Any) -> ArchiveConfig:
    """Return a configuration from a shipped one's name, a YAML file or a configuration, with some fields changed.

    Raises
    ------
    ConfigError
        If a key is unknown or a value impossible.
    InputError
        If a name stands for nothing.
    """
    return load_settings(KIND, ArchiveConfig(), source, **changes)
