"""Configurations of the synthesis of an archive: a front of policies, or policies far apart."""

import os
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval, MinLen

from pcs_racing.base.errors import ConfigError, check_choice, check_path
from pcs_racing.base.settings import (
    DIFFERENT,
    Names,
    OneOf,
    OptionalNames,
    Settings,
    Text,
    load_settings,
    read_settings,
)
from pcs_racing.base.typing import Floats
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.racers import policy_racer
from pcs_racing.planners.registry import get_planner, parse_policy
from pcs_racing.race.config import Rules, load_rules
from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.policies.evaluate import GENERATED

SHIPPED_TRACKS = ("Tarnfjord", "Vellindra", "Kestrelheim")

_SECONDS = Interval(ge=0.1, le=3600.0)
_STARTS = Interval(ge=1, le=1000)


@dataclass(frozen=True, kw_only=True)
class ArchiveConfig(Settings):
    """Options of both ways to an archive.

    Durations are multiples of ``segment_seconds``. Every policy meets all pairs of opponents and
    start lines, from both sides, on every track. The three stages (search, choice, measurement)
    draw different opponents and start lines.
    """

    name: Annotated[Text, "Name of the archive."] = "archive"
    rules: Annotated[Text, "Rules of the races: a name or a YAML file."] = "paper"
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
    planner: Annotated[Text, "Planner of the policies."] = "lattice"
    start: Annotated[
        Text | None,
        "Policy of the planner that gives the values of fixed parameters; None for the default.",
    ] = None
    fixed: Annotated[
        OptionalNames,
        "Parameters of the planner that keep their values of the start: the search has a dimension"
        " less for each.",
    ] = ()
    characteristics: Annotated[
        Annotated[tuple[Text, ...], MinLen(2), DIFFERENT] | None,
        "Axes; None for the aggressiveness of the rules, then restraint (with speed: the reaction"
        " to the lead).",
    ] = None
    generations: Annotated[int, Interval(ge=0, le=100_000), "Number of generations."] = 60
    population: Annotated[int, Interval(ge=4, le=10_000), "Number of policies in a generation."] = (
        32
    )
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
    crash_limit: Annotated[
        float,
        Interval(ge=0.0, le=1.0),
        "Max share of crashes by own fault, in races of final_duration, of a policy in the"
        " archive; 1 keeps all. For the shorter races of the search it is converted with a constant"
        " crash rate.",
    ] = 0.08
    candidates: Annotated[
        int, Interval(ge=3, le=10_000), "Policies that race again in the selection."
    ] = 240
    max_policies: Annotated[int, Interval(ge=3, le=10_000), "Maximum number of policies."] = 80
    starts: Annotated[
        int, _STARTS, "Start lines on each track in the search; twice as many in the choice."
    ] = 2
    final_starts: Annotated[int, _STARTS, "Start lines on each track in the measurement."] = 3
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

    @property
    def race_rules(self) -> Rules:
        """Rules of the races, with the duration of a race in the search."""
        return self.rules_of(self.duration)

    def rules_of(self, duration: float) -> Rules:
        """Return the rules of the races, with another duration."""
        return load_rules(self.rules, duration=float(duration))

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
        first = self.race_rules.aggressiveness
        return (
            "aggressiveness" if first == "lead" else first,
            "reaction" if first == "speed" else "restraint",
        )

    @property
    def start_policy(self) -> Policy:
        """Policy that gives the values of fixed parameters."""
        return parse_policy(self.start or self.planner)

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the parameters that the search varies."""
        return get_planner(self.planner).without(self.fixed)

    @property
    def bounds(self) -> Floats:
        """Bounds of the varied parameters, shape (P, 2)."""
        planner = get_planner(self.planner)
        return planner.bounds[planner.indices(self.varied)]

    def circuits(self, stage: int) -> tuple[str, ...]:
        """Return the circuits of a stage: names and folders."""
        return self.tracks

    def met(self, stage: int) -> tuple[int, tuple[str, ...]]:
        """Return the number of random opponents in a stage, and policies that are met as well."""
        raise NotImplementedError

    @property
    def directions(self) -> tuple[tuple[int, ...], ...]:
        """Signs of the axes in each search."""
        return ((1,) * len(self.axes),)

    @property
    def evaluations(self) -> int:
        """Number of policies raced in the search, initial sample included."""
        return self.initial_sample + len(self.directions) * self.generations * self.population


@dataclass(frozen=True, kw_only=True)
class FrontConfig(ArchiveConfig):
    """A front of policies, none clearly better than another on all axes (the paper).

    One search, against random policies of the same planner; by default 2,000 policies and 96 races
    each. A parameter ``pace`` is at most 1: a circuit's calibration allows no more.
    """

    selection: Annotated[str, OneOf(("pareto",)), "Kind of the archive."] = "pareto"
    opponents: Annotated[
        int,
        Interval(ge=1, le=300),
        "Opponents (random policies) in the search; twice as many in the selection, three times as"
        " many in the measurement.",
    ] = 4
    generated: Annotated[
        int,
        Interval(ge=0, le=100),
        "Generated circuits in addition to the tracks, in search and measurement.",
    ] = 3
    choice_tracks: Annotated[
        Names,
        "Circuits of the choice, without the tracks of the search if others remain: who crashes too"
        " often there is no member.",
    ] = ("Pipkin", "Quillburg")
    min_coordinates: Annotated[
        tuple[float, ...] | None,
        "Min coordinate of a policy in the archive, one for each axis; None for no limit.",
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_coordinates is not None and len(self.min_coordinates) != len(self.axes):
            raise ConfigError(
                f"min_coordinates is {self.min_coordinates!r}; it must list a number for each of"
                f" {', '.join(self.axes)}"
            )

    @property
    def bounds(self) -> Floats:
        """Bounds of the varied parameters, shape (P, 2), with a pace of at most 1."""
        bounds = super().bounds.copy()
        if "pace" in self.varied:
            row = self.varied.index("pace")
            bounds[row, 1] = min(bounds[row, 1], 1.0)
        return bounds

    def circuits(self, stage: int) -> tuple[str, ...]:
        """Return the circuits of a stage: names and folders."""
        if stage == 1:
            left_out = tuple(track for track in self.choice_tracks if track not in self.tracks)
            return left_out or self.choice_tracks
        return (*self.tracks, *(f"{GENERATED}{k}" for k in range(self.generated)))

    def met(self, stage: int) -> tuple[int, tuple[str, ...]]:
        """Return the number of random opponents in a stage, and no other policies."""
        return (stage + 1) * self.opponents, ()


@dataclass(frozen=True, kw_only=True)
class SpreadConfig(ArchiveConfig):
    """Strong policies that are far from each other.

    A tuning from the start finds the champion; searches from it go in all directions of the axes.
    """

    selection: Annotated[str, OneOf(("spread",)), "Kind of the archive."] = "spread"
    rivals: Annotated[
        Names, "Opponents: policies of any planner, and in all stages after it the champion."
    ] = ("lattice:early",)
    champion_generations: Annotated[
        int, Interval(ge=1, le=100_000), "Generations of the tuning, of its default population."
    ] = 80
    margin: Annotated[
        float,
        Interval(ge=0.0, le=1.0),
        "Max distance of a policy's score (win 1, tie 1/2) below the champion's score.",
    ] = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        for rival in self.rivals:
            policy_racer(rival)

    def met(self, stage: int) -> tuple[int, tuple[str, ...]]:
        """Return no random opponents, and the rivals."""
        return 0, self.rivals

    @property
    def directions(self) -> tuple[tuple[int, ...], ...]:
        """Signs of the axes in each search: all of them."""
        return tuple(product((1, -1), repeat=len(self.axes)))


SELECTIONS: dict[str, ArchiveConfig] = {"pareto": FrontConfig(), "spread": SpreadConfig()}
"""Default configurations, by kind."""


def load_archive_config(
    source: str | Path | ArchiveConfig | None = None, **changes: Any
) -> ArchiveConfig:
    """Return a configuration by shipped name, YAML file or object, with some fields changed.

    ``selection`` in a file ("pareto" by default, or "spread") selects the kind.
    """
    if isinstance(source, ArchiveConfig):
        return load_settings("archive", source, None, **changes)
    default, shipped = SELECTIONS["pareto"], shipped_configs("archive")
    if source is None:
        return load_settings("archive", default, None, **changes)
    path = shipped.get(str(check_path("settings", source, ConfigError)), source)
    if os.path.isfile(path):
        kind = read_settings(path).get("selection", "pareto")
        default = SELECTIONS[check_choice(f"{path}: selection", kind, SELECTIONS, ConfigError)]
    return load_settings("archive", default, source, shipped, **changes)
