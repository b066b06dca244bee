"""Tuning of a planner: the search for its strongest safe policy against some opponents.

1. **Search.** CMA-ES moves a distribution of parameters. All policies of a generation drive the
   same races: every opponent on every track, from both sides. Each generation drives new races, so
   that no policy wins by the luck of a few starts. A policy is ranked by its score (win 1, tie
   1/2), less a price for own crashes beyond a limit. The price is 0 in the first half of the
   search and grows in the second: with the full price from the start, the search slows down the
   first policy and stays there, since the way to a fast and safe policy leads through fast ones.
2. **Choice.** The start and the means of some generations of the second half race again, in more
   races, also on circuits held out of the search. Of the means that beat the start the one with the
   max score less the price of own crashes is the finalist.
3. **Check.** Start and finalist race once more on these circuits. The finalist is the tuned policy
   if it beats the start by its score, and by its score less the price; else the start is kept.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import yaml
from annotated_types import Interval
from numpy.typing import NDArray

from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.base.files import write_atomically
from pcs_racing.base.seeds import signed_seed
from pcs_racing.base.settings import Names, OptionalNames, Settings, Text, plain_settings
from pcs_racing.base.typing import Floats
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.racers import policy_racer
from pcs_racing.planners.registry import get_planner, parse_policy
from pcs_racing.race.config import Rules, load_rules
from pcs_racing.track.loading import load_track
from pcs_racing_agents.base.jobs import Arrays, Job, open_job
from pcs_racing_agents.base.statistics import clustered_mean
from pcs_racing_agents.base.tables import Column, table_rows, write_csv
from pcs_racing_agents.policies.evaluate import (
    Evaluation,
    Scenarios,
    draw_scenarios,
    race_in_blocks,
    race_points,
    summarise,
)
from pcs_racing_agents.policies.search import CubeCMAES

CRASH_PRICE = 3.0
"""Lost races that an own crash beyond the limit is worth, besides the race that it loses."""
FINALISTS = 8  # means of generations that race again
CHOICE_STARTS = 4  # times the start lines of the search, at least
MIN_PARAMETERS = 2  # of CMA-ES

TUNING_TRACKS = ("Tarnfjord", "Brackwater", "Pipkin", "Kestrelheim", "Quillburg")
HELD_OUT = ("Saltmere", "Vellindra")


@dataclass(frozen=True)
class TuningConfig(Settings):
    """Configuration of the tuning of a planner."""

    planner: Annotated[Text, "Planner whose parameters are tuned."] = "lattice"
    against: Annotated[Names, "Opponents: policies, met equally often."] = ("lattice:early",)
    tracks: Annotated[Names, "Names or folders of the circuits of search and choice."] = (
        TUNING_TRACKS
    )
    held_out: Annotated[OptionalNames, "Circuits of choice and check only."] = HELD_OUT
    rules: Annotated[Text, "Rules of the races: a name or a YAML file."] = "contest"
    duration: Annotated[float, Interval(ge=0.1, le=3600.0), "Length of a race, s."] = 40.0
    start: Annotated[
        Text | None, "Policy that the search starts from, by default the planner's default policy."
    ] = None
    fixed: Annotated[OptionalNames, "Parameters that keep their values of the start."] = ()
    generations: Annotated[int, Interval(ge=1, le=100_000), "Number of generations."] = 80
    population: Annotated[int, Interval(ge=4, le=10_000), "Policies of a generation."] = 16
    step_size: Annotated[
        float,
        Interval(ge=1e-6, le=1.0),
        "Initial standard deviation of CMA-ES, as a share of the parameters' ranges.",
    ] = 0.25
    starts: Annotated[
        int, Interval(ge=1, le=1000), "Start lines on each track, for each opponent."
    ] = 2
    check_starts: Annotated[
        int,
        Interval(ge=2, le=10_000),
        "Start lines of choice and check, for each opponent and track.",
    ] = 20
    crash_limit: Annotated[
        float, Interval(ge=0.0, le=1.0), "Share of own crashes that costs nothing."
    ] = 0.05
    seed: Annotated[int, Interval(ge=0, le=2**63 - 1), "Seed of all random draws."] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        names = get_planner(self.planner).without(self.fixed)
        if len(names) < MIN_PARAMETERS:
            raise ConfigError(
                f"planner {self.planner!r} has {', '.join(names) or 'nothing'} to tune; the search"
                f" needs {MIN_PARAMETERS} parameters at least"
            )
        for policy in self.against:
            policy_racer(policy)
        if self.start_policy.planner.name != self.planner:
            raise ConfigError(
                f"start is {self.start!r}; it must be a policy of planner {self.planner!r}"
            )
        both = set(self.tracks) & set(self.held_out)
        if both:
            raise ConfigError(f"held_out names {sorted(both)[0]!r}, a circuit of the search")
        _ = self.race_rules

    @property
    def start_policy(self) -> Policy:
        """Policy that the search starts from."""
        return parse_policy(self.start or self.planner)

    @property
    def race_rules(self) -> Rules:
        """Rules of the races."""
        return load_rules(self.rules, duration=float(self.duration))


class TuningProgress(NamedTuple):
    """Progress after a generation of the search."""

    generation: int
    score: float  #: Mean score of the generation's policies.
    best: float  #: Max score less the price of crashes.
    own_crash: float  #: Mean share of own crashes.
    step_size: float  #: Max standard deviation, as a share of a parameter's range.


TuningCallback = Callable[[str, int, int, TuningProgress | None], object]
"""Callback ``(stage, done, total, progress)`` after each generation, and in later stages."""


class CheckLine(NamedTuple):
    """Result of a policy against an opponent on a circuit, in the races of the check."""

    policy: str  #: ``start`` or ``tuned``: the same, if the start was kept.
    track: str
    held_out: str  #: ``yes`` for a circuit held out of the search.
    opponent: str
    races: int
    score: float  #: Share of races won; a tie is a half.
    low: float  #: ``low``, ``high``: 95 % interval, clustered by start line.
    high: float
    own_crash: float  #: Share of races that ended by a crash of the policy's own fault.


CHECK = (
    *map(Column, ("policy", "track", "held_out", "opponent", "races")),
    *(Column(name, format=".4f") for name in ("score", "low", "high", "own_crash")),
)
COURSE = (
    Column("generation"),
    *(Column(name, format=".4f") for name in ("score", "best", "own_crash", "step_size")),
)
"""Columns of ``check.csv`` and ``progress.csv``."""


class Tuned(NamedTuple):
    """Result of a tuning."""

    policy: Policy
    check: list[CheckLine]
    course: list[TuningProgress]
    kept: str  #: Line with the kept policy, and scores of start and finalist in the check.


def tune(
    config: TuningConfig,
    folder: str | Path,
    *,
    executor: Executor | None = None,
    callback: TuningCallback | None = None,
) -> Tuned:
    """Tune a planner; write ``tuned.yaml``, ``check.csv`` and ``progress.csv``.

    A stopped run resumes when it is started again with the same settings.

    Parameters
    ----------
    folder : str or Path
        A new or empty folder, or the folder of a stopped run of the same tuning.
    executor : Executor, optional
        Executor of the races (:func:`pcs_racing_agents.base.executors.make_executor`). It has no
        influence on the result.
    """
    folder = Path(folder)
    tracks = (*config.tracks, *config.held_out)
    hashes = {name: load_track(name).content_hash for name in tracks}
    for name in config.held_out:
        if hashes[name] in {hashes[track] for track in config.tracks}:
            raise InputError(f"held_out names {name!r}, a circuit of the search")
    settings = {**plain_settings(config), "rules": config.race_rules, "track_hashes": hashes}
    with open_job(folder, "tuning", settings) as job:
        run = TuningRun(config, job, executor, callback or (lambda *_: None))
        text = policy_text(get_planner(config.planner), run.finalist(run.search()))
        # The policy as it is written, with four digits.
        check, both = run.check(parse_policy(text).parameters)
        if not beats_start(both, config.crash_limit)[1]:
            text = config.start or config.planner
            own = [line for line in check if line.policy == "start"]
            check = [*own, *(line._replace(policy="tuned") for line in own)]
        kept = kept_words(both, config.crash_limit)
        write_csv(table_rows(CHECK, check), folder / "check.csv")
        write_csv(table_rows(COURSE, run.course), folder / "progress.csv")
        about = {"policy": text, "kept": kept, **plain_settings(config)}
        write_atomically(folder / "tuned.yaml", yaml.safe_dump(about, sort_keys=False))
        return Tuned(parse_policy(text), check, run.course, kept)


def kept_words(both: Evaluation, crash_limit: float) -> str:
    """Return a line with the kept policy: the start, unless the finalist beats it."""
    start, finalist = (
        f"{score:.3f} (own crashes {crash:.1%}, their price {price:.3f})"
        for score, crash, price in zip(
            both.score, both.own_crash, both.score - fitness(both, crash_limit), strict=True
        )
    )
    which = "finalist" if beats_start(both, crash_limit)[1] else "start"
    return f"kept: the {which}; scores in the check: start {start}, finalist {finalist}"


def policy_text(planner: Planner, theta: Floats) -> str:
    """Return a policy as a text for :func:`pcs_racing.racer`, with four digits."""
    values = zip(planner.parameters, theta, strict=True)
    pairs = (f"{p.name}={np.clip(float(f'{v:.4g}'), p.low, p.high):.6g}" for p, v in values)
    return f"{planner.name}:{','.join(pairs)}"


@dataclass(frozen=True)
class TuningRun:
    """Stages of a tuning, whose races are tasks of a job."""

    config: TuningConfig
    job: Job
    executor: Executor | None
    callback: TuningCallback
    name: str = "search"  #: Beginning of the names of the tasks.
    course: list[TuningProgress] = field(default_factory=list)

    def search(self) -> Floats:
        """Return the start and the means of the distribution after each generation, (N + 1, P)."""
        config, planner = self.config, get_planner(self.config.planner)
        root, draws = np.random.SeedSequence(config.seed).spawn(2)
        names, start = planner.without(config.fixed), config.start_policy.parameters
        varied = planner.indices(names)
        low, high = planner.bounds[varied].T

        def vectors(unit: Floats) -> Floats:
            return planner.complete(names, low + unit * (high - low), start)

        es = CubeCMAES(
            (start[varied] - low) / (high - low),
            config.step_size,
            2.0 * config.step_size,
            config.population,
            config.population // 2,
            np.random.default_rng(draws),
            bounded=True,
        )
        means = [start]
        for number, child in enumerate(root.spawn(config.generations), 1):
            name = f"{self.name}-{number:05d}"
            found = self._race(name, vectors(es.ask()), child, config.starts)
            grown = max(0.0, 2.0 * number / config.generations - 1.0)
            value = fitness(found, config.crash_limit, grown)
            es.tell(np.argsort(np.argsort(-value, kind="stable"), kind="stable").astype(float))
            means.append(vectors(es.mean[None])[0])
            about = (found.score.mean(), value.max(), found.own_crash.mean(), es.step_size)
            self.course.append(TuningProgress(number, *map(float, about)))
            self.callback("search", number, config.generations, self.course[-1])
        return np.stack(means)

    def choose(self, means: Floats) -> Floats:
        """Return the best of the start and some means of the second half, by new races, (P,)."""
        starts = CHOICE_STARTS * self.config.starts
        finalists, found = self._choice(means, self.config.tracks, starts)
        return np.asarray(finalists[fitness(found, self.config.crash_limit).argmax()])

    def finalist(self, means: Floats) -> Floats:
        """Return the best mean of the second half, by races on all circuits of the check, (P,).

        Means that beat the start come first.
        """
        config = self.config
        tracks = (*config.tracks, *config.held_out)
        starts = max(config.check_starts, CHOICE_STARTS * config.starts)
        finalists, found = self._choice(means, tracks, starts)
        value, beats = (of(found, config.crash_limit)[1:] for of in (fitness, beats_start))
        return np.asarray(finalists[1:][np.lexsort((value, beats))[-1]])

    def check(self, theta: Floats) -> tuple[list[CheckLine], Evaluation]:
        """Race the start and a policy in new races, on the circuits held out, too."""
        config = self.config
        seed = np.random.SeedSequence(config.seed, spawn_key=(3,))
        tracks = (*config.tracks, *config.held_out)
        scenarios = self._scenarios(tracks, seed, config.check_starts)
        policies = np.stack([config.start_policy.parameters, theta])
        raced = self._raced(f"{self.name}-check", policies, scenarios)
        self.callback("check", 1, 1, None)
        return list(_check_lines(config, scenarios, raced)), summarise(raced)

    def _choice(
        self, means: Floats, tracks: tuple[str, ...], starts: int
    ) -> tuple[Floats, Evaluation]:
        """Race the start and some means of the second half; return them with their results."""
        last = self.config.generations
        steps = np.linspace(last, last // 2 + 1, FINALISTS).round().astype(int)
        finalists = means[np.unique([0, *steps])]
        seed = np.random.SeedSequence(self.config.seed, spawn_key=(2,))
        scenarios = self._scenarios(tracks, seed, starts)
        found = summarise(self._raced(f"{self.name}-choice", finalists, scenarios))
        self.callback("choice", 1, 1, None)
        return finalists, found

    def _race(
        self, name: str, theta: Floats, seed: np.random.SeedSequence, starts: int
    ) -> Evaluation:
        scenarios = self._scenarios(self.config.tracks, seed, starts)
        return summarise(self._raced(name, theta, scenarios))

    def _scenarios(
        self, tracks: tuple[str, ...], seed: np.random.SeedSequence, starts: int
    ) -> Scenarios:
        config = self.config
        return draw_scenarios(
            config.planner,
            tracks,
            config.race_rules,
            rivals=config.against,
            starts=starts,
            seed=signed_seed(seed),
        )

    def _raced(self, name: str, theta: Floats, scenarios: Scenarios) -> Arrays:
        """Race policies as tasks of this name, a few at once, or load results of earlier runs."""
        block = max(1, len(theta) // 4)
        return race_in_blocks(name, scenarios, theta, block, job=self.job, executor=self.executor)


def fitness(found: Evaluation, crash_limit: float, price: float = 1.0) -> Floats:
    """Return scores less a share of the price of own crashes beyond a limit, shape (K,)."""
    return found.score - price * CRASH_PRICE * np.maximum(found.own_crash - crash_limit, 0.0)


def beats_start(found: Evaluation, crash_limit: float) -> NDArray[np.bool_]:
    """Return which policies beat the first by the score, and by the score less the price, (K,)."""
    value = fitness(found, crash_limit)
    return (found.score > found.score[0]) & (value > value[0])


def _check_lines(config: TuningConfig, scenarios: Scenarios, raced: Arrays) -> Iterator[CheckLine]:
    points = race_points(raced)
    for k, policy in enumerate(("start", "tuned")):
        for t, track in enumerate(scenarios.tracks):
            for o, opponent in enumerate(config.against):
                races = np.flatnonzero((scenarios.track == t) & (scenarios.opponent == o))
                score = clustered_mean(points[k, races], scenarios.start_s[races])
                yield CheckLine(
                    policy,
                    track,
                    "yes" if track in config.held_out else "no",
                    opponent,
                    len(races),
                    score.mean,
                    max(score.low, 0.0),
                    min(score.high, 1.0),
                    float(raced["own_crash"][k, races].mean()),
                )
