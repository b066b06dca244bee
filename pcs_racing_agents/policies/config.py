"""Configuration of the synthesis of an archive."""

from dataclasses import dataclass
from math import comb
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from pcs_racing.base.errors import ConfigError
from pcs_racing.base.settings import Names, OneOf, OptionalNames, Settings, Text
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.planners.registry import get_planner, parse_policy
from pcs_racing.race.config import RaceConfig, load_race_config
from pcs_racing_agents.base.configurations import load_config, shipped_configs

CHOICES = ("pareto", "headroom")
"""Rules of selection: policies that no other policy clearly beats, or a pool with headroom."""

KIND = "archive"
HEADROOM_SETTINGS = ("groups", "payoff_races", "judging_races", "judging_tracks")
"""Options that only matter with ``selection: headroom``."""
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
    fixed: Annotated[
        OptionalNames,
        "Parameters of the planner that keep their defaults: the search has a dimension less for"
        " each, and the archive does not hold them.",
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
        int, Interval(ge=1, le=1000), "Opponents (random policies) in the search."
    ] = 4
    rivals: Annotated[
        OptionalNames,
        "Policies of other planners that are met in every stage as well as the random policies,"
        " each as often.",
    ] = ()
    min_score: Annotated[
        float,
        Interval(ge=0.0, le=1.0),
        "Smallest score against the rivals, a win being 1 and a tie 1/2, of a policy that may be"
        " chosen.",
    ] = 0.0
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
        " or a pool with much headroom, chosen from the payoffs of all pairs of candidates.",
    ] = "pareto"
    candidates: Annotated[
        int, Interval(ge=2, le=10_000), "Policies that race again in the selection."
    ] = 240
    choice_opponents: Annotated[int, Interval(ge=1, le=1000), "Opponents in the selection."] = 8
    choice_starts: Annotated[
        int, Interval(ge=1, le=1000), "Start lines on each track in the selection."
    ] = 2
    error_bars: Annotated[
        float,
        Interval(ge=0.0, le=10.0),
        "A policy is dominated if another one is better on all axes by more than this number of"
        " standard errors of the difference.",
    ] = 1.0
    groups: Annotated[
        int,
        Interval(ge=1, le=1000),
        "With selection: headroom, groups of candidates along the first axis that as many policies"
        " are taken from.",
    ] = 4
    payoff_races: Annotated[
        int,
        Interval(ge=4, le=100_000),
        "With selection: headroom, races of each pair of candidates on each track.",
    ] = 16
    judging_races: Annotated[
        int,
        Interval(ge=4, le=100_000),
        "With selection: headroom, races of each pair of the chosen policies on each track, whose"
        " headroom the manifest states.",
    ] = 64
    judging_tracks: Annotated[
        Names | None,
        "With selection: headroom, circuits that no choice is made on, on which it is judged, too.",
    ] = None
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
        Interval(ge=1, le=1000),
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
        if self.min_score > 0.0 and not self.rivals:
            raise ConfigError(
                f"min_score is {self.min_score:g}, but there are no rivals to reach it against"
            )
        if self.selection == "headroom":
            self._check_headroom()
        if not self.varied:
            raise ConfigError(
                f"fixed names all parameters of planner {self.planner!r}; at least one must vary"
            )
        get_characteristics(self.axes)
        for rival in self.rivals:
            parse_policy(rival)
        if self.min_coordinates is not None and len(self.min_coordinates) != len(self.axes):
            raise ConfigError(
                f"min_coordinates is {self.min_coordinates!r}; it must list a number for each of"
                f" {', '.join(self.axes)}"
            )

    def _check_headroom(self) -> None:
        """Check the options that only the choice for headroom needs."""
        if not 3 <= self.max_policies <= self.candidates:
            raise ConfigError(
                f"max_policies is {self.max_policies}; a pool chosen for headroom holds 3 policies"
                f" at least, and no more than there are candidates, {self.candidates}"
            )
        if self.groups > self.max_policies:
            raise ConfigError(f"groups is {self.groups}, above max_policies, {self.max_policies}")
        for key in ("payoff_races", "judging_races"):
            if getattr(self, key) % 4:
                raise ConfigError(f"{key} is {getattr(self, key)}; it must be a multiple of 4")
        both = set(self.tracks) & set(self.judging_tracks or ())
        if both:
            raise ConfigError(
                f"judging_tracks names {sorted(both)[0]!r}, which has a say in the choice"
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
    def varied(self) -> tuple[str, ...]:
        """Names of the parameters that the search varies and the archive holds."""
        return get_planner(self.planner).without(self.fixed)

    @property
    def evaluations(self) -> int:
        """Maximum number of policies raced in the search, initial sample included."""
        return self.initial_sample + self.generations * self.population

    @property
    def work(self) -> dict[str, float]:
        """Maximum racing time of each stage, s."""
        met = 2 * len(self.tracks)  # both sides of each start line, on all tracks
        rivals = len(self.rivals)
        search = met * (self.opponents + rivals) * self.starts
        choice = met * (self.choice_opponents + rivals) * self.choice_starts
        final = met * (self.final_opponents + rivals) * self.final_starts
        work = {
            "search": self.evaluations * search * self.duration,
            "choice": self.candidates * choice * self.duration,
            "measurement": self.max_policies * final * self.final_duration,
        }
        if self.selection == "headroom":
            judging = len(self.tracks) + len(self.judging_tracks or ())
            pairs, chosen = comb(self.candidates, 2), comb(self.max_policies, 2)
            work["choice"] = pairs * len(self.tracks) * self.payoff_races * self.final_duration
            work["judgement"] = chosen * judging * self.judging_races * self.final_duration
        return work


def list_archive_configs() -> list[str]:
    """Return the names of the shipped configurations."""
    return list(shipped_configs(KIND))


def load_archive_config(
    source: str | Path | ArchiveConfig | None = None, **changes: Any
) -> ArchiveConfig:
    """Return a configuration by shipped name, YAML file or object, with some fields changed."""
    return load_config(KIND, ArchiveConfig(), source, **changes)
