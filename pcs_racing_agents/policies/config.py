"""Configuration of the synthesis of an archive."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from pcs_racing.base.errors import ConfigError
from pcs_racing.base.settings import Names, OneOf, OptionalNames, Settings, Text
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import get_planner, parse_policy
from pcs_racing.race.config import RaceConfig, load_race_config
from pcs_racing_agents.base.configurations import load_config, shipped_configs
from pcs_racing_agents.policies.tuning import TuningConfig

CHOICES = ("pareto", "spread")
"""Rules of selection: policies that no other policy clearly beats, or policies far apart."""

KIND = "archive"
SPREAD_SETTINGS = ("margin",)
"""Options that only matter with ``selection: spread``."""
SHIPPED_TRACKS = ("Tarnfjord", "Vellindra", "Kestrelheim")

_SECONDS = Interval(ge=0.1, le=3600.0)


@dataclass(frozen=True)
class ArchiveConfig(Settings):
    """Configuration of an archive: 2,000 policies and 48 races each by default.

    Durations are multiples of ``segment_seconds``. Every policy meets all pairs of opponents and
    start lines, from both sides, on every track. The three stages (search, choice, measurement)
    draw different opponents and start lines.
    """

    name: Annotated[Text, "Name of the archive."] = "archive"
    preset: Annotated[Text, "Rules of the races: a preset's name or a YAML file."] = "paper"
    duration: Annotated[float, _SECONDS, "Length of a race during search and selection, s."] = 16.0
    final_duration: Annotated[float, _SECONDS, "Length of a race in the final measurement, s."] = (
        40.0
    )
    segment_seconds: Annotated[
        float,
        _SECONDS,
        "Length of the segments whose mean is a coordinate, s: a step of the game.",
    ] = 8.0
    tracks: Annotated[
        Names,
        "Names or folders of the circuits; all policies race on all of them.",
    ] = SHIPPED_TRACKS
    planner: Annotated[Text, "Planner of the policies and of their opponents."] = "lattice"
    start: Annotated[
        Text | None,
        "Policy of the planner that the first champion and fixed parameters start from; None for"
        " the default.",
    ] = None
    fixed: Annotated[
        OptionalNames,
        "Parameters of the planner that keep their values of the start: the search has a dimension"
        " less for each.",
    ] = ()
    characteristics: Annotated[
        Names | None,
        "Axes; None takes what the rules name as their aggressiveness, which is aggressiveness"
        " itself (the lead), pace or speed, and then restraint (with speed: the reaction to the"
        " lead).",
    ] = None
    generations: Annotated[int, Interval(ge=0, le=100_000), "Number of generations."] = 60
    population: Annotated[int, Interval(ge=4, le=10_000), "Number of policies in a generation."] = (
        32
    )
    elite_ratio: Annotated[
        float,
        Interval(ge=0.01, le=1.0),
        "Share of a generation that updates the distribution.",
    ] = 0.5
    step_size: Annotated[
        float,
        Interval(ge=1e-6, le=1.0),
        "Initial standard deviation of CMA-ES, as a share of the parameters' ranges.",
    ] = 0.3
    initial_sample: Annotated[
        int,
        Interval(ge=8, le=10_000),
        "Policies of the initial sample, drawn at random; their range is the scale of the axes in"
        " the loss and in the hypervolume, and the best of them are the first archive.",
    ] = 80
    opponents: Annotated[
        int, Interval(ge=0, le=1000), "Opponents (random policies) in the search."
    ] = 4
    rivals: Annotated[
        OptionalNames,
        "Policies of other planners that are met in every stage as well as the random policies,"
        " each as often.",
    ] = ()
    champions: Annotated[
        int,
        Interval(ge=0, le=100),
        "Tunings before the search: each finds the strongest policy against the rivals and the"
        " champions before it. All champions are rivals of the search, which starts at the last.",
    ] = 0
    champion_generations: Annotated[
        int, Interval(ge=1, le=100_000), "Generations of a tuning, of the default population."
    ] = 80
    margin: Annotated[
        float,
        Interval(ge=0.0, le=1.0),
        "With selection: spread, how far a policy's score against the rivals (win 1, tie 1/2) may"
        " lie below that of the last champion, or of the start without champions.",
    ] = 0.1
    starts: Annotated[int, Interval(ge=1, le=1000), "Start lines on each track in the search."] = 2
    crash_limit: Annotated[
        float,
        Interval(ge=0.0, le=1.0),
        "Largest share of crashes by own fault, in races of final_duration, of a policy in the"
        " archive; 1 keeps all. For the shorter races of the search it is converted with a constant"
        " crash rate.",
    ] = 0.15
    min_coordinates: Annotated[
        tuple[float, ...] | None,
        "Smallest coordinate of a policy in the archive, one for each axis; None for no limit.",
    ] = None
    selection: Annotated[
        str,
        OneOf(CHOICES),
        "Rule of the selection: policies that no other one clearly beats on the axes (the paper),"
        " or strong policies that are far from each other, found by searches in all directions.",
    ] = "pareto"
    candidates: Annotated[
        int, Interval(ge=2, le=10_000), "Policies that race again in the selection."
    ] = 240
    choice_opponents: Annotated[int, Interval(ge=0, le=1000), "Opponents in the selection."] = 8
    choice_starts: Annotated[
        int, Interval(ge=1, le=1000), "Start lines on each track in the selection."
    ] = 2
    error_bars: Annotated[
        float,
        Interval(ge=0.0, le=10.0),
        "A policy is dominated if another one is better on all axes by more than this number of"
        " standard errors of the difference.",
    ] = 1.0
    spacing: Annotated[
        float,
        Interval(ge=0.0, le=0.5),
        "Smallest distance between two policies of the archive, in units of the archive's ranges;"
        " of two nearer policies one is dropped.",
    ] = 0.015
    min_policies: Annotated[
        int,
        Interval(ge=1, le=10_000),
        "Minimum number of policies in the archive, if possible.",
    ] = 40
    max_policies: Annotated[
        int,
        Interval(ge=2, le=10_000),
        "Maximum number of policies; with more, the spacing is widened.",
    ] = 80
    final_opponents: Annotated[
        int,
        Interval(ge=0, le=1000),
        "Opponents in the measurement, which gives the coordinates.",
    ] = 12
    final_starts: Annotated[
        int, Interval(ge=1, le=1000), "Start lines on each track in the measurement."
    ] = 3
    seed: Annotated[int, Interval(ge=0, le=2**63 - 1), "Seed of all random draws."] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("duration", "final_duration"):
            length = getattr(self, key)
            segments = round(length / self.segment_seconds)
            if segments < 1 or abs(segments * self.segment_seconds - length) > 1e-9:
                raise ConfigError(
                    f"{key} is {length:g} s; it must be a multiple of segment_seconds,"
                    f" {self.segment_seconds:g} s"
                )
        if self.min_policies > self.max_policies:
            raise ConfigError(
                f"min_policies is {self.min_policies}, above max_policies, {self.max_policies}"
            )
        if self.selection == "spread":
            self._check_spread()
        if self.champions and not self.rivals:
            raise ConfigError(f"champions is {self.champions}, but there are no rivals to beat")
        if not self.rivals and not all(
            (self.opponents, self.choice_opponents, self.final_opponents)
        ):
            raise ConfigError("there are no rivals, and a stage has no opponents: nobody to race")
        if len(self.varied) < 2:
            raise ConfigError(
                f"fixed leaves {len(self.varied)} parameters of planner {self.planner!r}; at least"
                " 2 must vary"
            )
        if self.start_policy.planner.name != self.planner:
            raise ConfigError(
                f"start is {self.start!r}; it must be a policy of planner {self.planner!r}"
            )
        get_characteristics(self.axes)
        if len(self.axes) < 2:
            raise ConfigError(f"characteristics are {self.axes!r}; the search needs at least 2")
        for rival in self.rivals:
            parse_policy(rival)
        if self.min_coordinates is not None and len(self.min_coordinates) != len(self.axes):
            raise ConfigError(
                f"min_coordinates is {self.min_coordinates!r}; it must list a number for each of"
                f" {', '.join(self.axes)}"
            )

    def _check_spread(self) -> None:
        """Check the options that only the choice of policies far apart needs."""
        if not self.rivals:
            raise ConfigError("selection is 'spread', but there are no rivals to measure strength")
        for key in ("candidates", "max_policies"):
            if getattr(self, key) < 3:
                raise ConfigError(
                    f"{key} is {getattr(self, key)}; policies far apart are at least 3"
                )

    @property
    def rules(self) -> RaceConfig:
        """Rules of the races, with the duration of a race in the search."""
        return self.rules_of(self.duration)

    def rules_of(self, duration: float) -> RaceConfig:
        """Return the rules of the races, with another duration."""
        return load_race_config(self.preset, duration=float(duration))

    @property
    def search_crash_limit(self) -> float:
        """Crash limit for races of the search."""
        # With a constant crash rate, the share that survives is exponential in the length of a
        # race.
        return float(1.0 - (1.0 - self.crash_limit) ** (self.duration / self.final_duration))

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the characteristics."""
        if self.characteristics is not None:
            return self.characteristics
        first = self.rules.aggressiveness
        return (
            "aggressiveness" if first == "lead" else first,
            "reaction" if first == "speed" else "restraint",
        )

    @property
    def start_policy(self) -> Policy:
        """Policy that the first champion and fixed parameters start from."""
        return parse_policy(self.start or self.planner)

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the parameters that the search varies."""
        return get_planner(self.planner).without(self.fixed)

    @property
    def directions(self) -> tuple[tuple[int, ...], ...]:
        """Signs of the axes in each search: all directions for policies far apart, else one."""
        signs = tuple(product((1, -1), repeat=len(self.axes)))
        return signs if self.selection == "spread" else signs[:1]

    @property
    def evaluations(self) -> int:
        """Maximum number of policies raced in the search, initial sample included."""
        return self.initial_sample + len(self.directions) * self.generations * self.population

    def rivals_with(self, champions: Sequence[str]) -> tuple[str, ...]:
        """Return rivals and champions, each policy once: a tuning may keep its start."""
        return tuple(dict.fromkeys((*self.rivals, *champions)))

    def tuning(self, champions: Sequence[str], seed: int) -> TuningConfig:
        """Return the tuning of the next champion, which starts at the last one."""
        return TuningConfig(
            planner=self.planner,
            against=self.rivals_with(champions),
            tracks=self.tracks,
            held_out=(),
            preset=self.preset,
            duration=self.final_duration,
            start=champions[-1] if champions else self.start,
            fixed=self.fixed,
            generations=self.champion_generations,
            crash_limit=min(self.crash_limit, TuningConfig.crash_limit),
            seed=seed,
        )

    @property
    def work(self) -> dict[str, float]:
        """Maximum racing time of each stage, s."""
        met = 2 * len(self.tracks)  # both sides of each start line, on all tracks
        rivals = len(self.rivals) + self.champions
        search = met * (self.opponents + rivals) * self.starts
        choice = met * (self.choice_opponents + rivals) * self.choice_starts
        final = met * (self.final_opponents + rivals) * self.final_starts
        work = {
            "search": self.evaluations * search * self.duration,
            "choice": self.candidates * choice * self.duration,
            "measurement": self.max_policies * final * self.final_duration,
        }
        if self.champions:
            one = self.tuning((), 0)
            policies = one.generations * one.population
            races = met * (len(self.rivals) + self.champions / 2) * one.starts
            work = {"champions": self.champions * policies * races * self.final_duration, **work}
        return work


def list_archive_configs() -> list[str]:
    """Return the names of the shipped configurations."""
    return list(shipped_configs(KIND))


def load_archive_config(
    source: str | Path | ArchiveConfig | None = None, **changes: Any
) -> ArchiveConfig:
    """Return a configuration by shipped name, YAML file or object, with some fields changed."""
    return load_config(KIND, ArchiveConfig(), source, **changes)
