"""A study: declared configuration, and a folder as the context of its stages."""

import os
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval, MultipleOf

from pcs_racing.base.errors import ConfigError
from pcs_racing.base.settings import Names, OptionalNames, Settings, Text
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import list_archives, load_archive
from pcs_racing.game.config import FIRST_STEPS, STEP_SIZES, GameConfig, load_game_config
from pcs_racing.game.make import make_game
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.config import load_race_config
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.agent import Agent, Competitor
from pcs_racing_agents.agents.game_spec import GameSpec, make_game_spec
from pcs_racing_agents.agents.zoo import build, parse_agent
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.base.progress import Progress, show_progress
from pcs_racing_agents.learning.ppo.settings import load_ppo_settings
from pcs_racing_agents.learning.responses.learner import load_response_settings
from pcs_racing_agents.learning.self_play import load_self_play_settings
from pcs_racing_agents.networks.targets import get_target
from pcs_racing_agents.policies.config import load_archive_config

BEST_OPEN_LOOP = ("best-fixed", "best-schedule", "best-lead-plan")
"""Baselines fitted on training races: fixed policy, move sequence and lead-conditioned plan."""


@dataclass(frozen=True)
class StudyConfig(Settings):
    """Configuration of a study; it determines the results."""

    race: Annotated[Text, "Rules: a preset's name or a YAML file."] = "paper"
    epsilon: Annotated[
        float | tuple[float, ...], STEP_SIZES, "Length of a move, in normalised coordinates."
    ] = 0.5
    moves: Annotated[
        int,
        Interval(ge=1, le=100),
        "Moves of each car in a game; None takes the steps of the rules.",
    ] = None  # type: ignore[assignment]
    step_seconds: Annotated[
        float,
        Interval(ge=0.1, le=600.0),
        MultipleOf(0.1),
        "Time between two moves, s.",
    ] = None  # type: ignore[assignment]
    first_steps: Annotated[
        tuple[float, ...],
        FIRST_STEPS,
        "Lengths of the first steps, as in the rules of the game, s.",
    ] = None  # type: ignore[assignment]
    synthesis: Annotated[
        Text | None, "Configuration of the synthesis; None uses an existing archive instead."
    ] = None
    archive: Annotated[Text, "Name or folder of the existing archive."] = "default"
    circuits: Annotated[Names, "Circuits of the trees and of training."] = ("Tarnfjord",)
    pairs: Annotated[int, Interval(ge=0, le=100_000), "Game trees on each circuit; 0 for none."] = (
        12
    )
    seeds: Annotated[
        int, Interval(ge=1, le=1000), "Noise realisations in each tree; 1 without noise."
    ] = 1
    training: Annotated[Text, "Settings of the networks' training."] = "study"
    targets: Annotated[
        Names,
        "Targets of the networks, in this order.",
    ] = (
        "regret",
        "normalised",
        "advantage",
        "static-q",
    )
    responses: Annotated[
        OptionalNames,
        "Settings of the learned responses"
        " (pcs_racing_agents.learning.responses.ResponseSettings).",
    ] = ()
    response_pool: Annotated[
        Names,
        "Opponents in the training of responses.",
    ] = (
        "never-switch",
        "random-moves",
    )
    sampled_cfr: Annotated[
        Text | None,
        "Settings (self-play) of counterfactual regrets from sampled games: the network of"
        ' "cfr-argmax" and "cfr-regret-matching", in place of one from full game trees; None for'
        " none.",
    ] = None
    fitting_games: Annotated[
        int,
        Interval(ge=2, le=1_000_000),
        "Games against each opponent on each circuit, to select the baselines; even.",
    ] = 100
    fixed_targets: Annotated[
        int,
        Interval(ge=0, le=1_000_000),
        "Candidate policies for the targets of best-fixed and best-lead-plan, spread over the"
        " archive; 0 for all.",
    ] = 16
    fitting_opponents: Annotated[Names, "Opponents in those games."] = ("never-switch",)
    tracks: Annotated[Names, "Circuits of the table."] = ("Tarnfjord",)
    opponents: Annotated[
        Names,
        "Opponents of the table.",
    ] = (
        "never-switch",
        "random-policy",
        "lane-switcher",
    )
    arms: Annotated[
        Names,
        "Agents of the table; the first is the baseline. With the three fitted baselines among them"
        " (best-fixed, best-schedule, best-lead-plan) the table has the adaptivity gain; some"
        " without the others are refused.",
    ] = ("never-switch", *BEST_OPEN_LOOP, "cfr-argmax")
    best: Annotated[Text, "The agent of main interest among them."] = "cfr-argmax"
    egos: Annotated[int, Interval(ge=2, le=1000), "Start policies of the ego in each cell."] = 20
    variants: Annotated[int, Interval(ge=2, le=1000), "Variants of the opponent in each cell."] = 20
    lines: Annotated[
        int, Interval(ge=1, le=1000), "Start lines of each cell; races start from both sides."
    ] = 5
    further_tracks: Annotated[OptionalNames, "Additional circuits of the second table."] = ()
    further_opponents: Annotated[OptionalNames, "Additional opponents of the second table."] = ()
    further_arms: Annotated[OptionalNames, "Additional agents of the second table."] = ()
    further_lines: Annotated[
        int, Interval(ge=0, le=1000), "Start lines of its cells; 0 for no second table."
    ] = 0
    ppo: Annotated[
        Text | None,
        "Settings (level duel) of a PPO baseline that is trained on the study's circuits, with its"
        ' archive and rules; None trains none, and the agent "ppo" is then the shipped one.',
    ] = None
    rated: Annotated[OptionalNames, "Agents of the round robin for the ratings."] = ()
    rating_races: Annotated[
        int,
        Interval(ge=2, le=2000),
        "Races of each pair of rated agents on each circuit of the table; even.",
    ] = 100
    seed: Annotated[int, Interval(ge=0, le=2**62), "Seed of all random draws."] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.game  # noqa: B018 - checks race and epsilon
        for name in self.targets:
            get_target(name)
        for name in self.responses:
            load_response_settings(name)
        if self.sampled_cfr is not None:
            load_self_play_settings(self.sampled_cfr)
        if self.sampled_cfr is not None and "regret" in self.targets and self.pairs > 0:
            raise ConfigError(
                f"sampled_cfr is {self.sampled_cfr!r} and targets hold 'regret'; name one source of"
                " the regrets"
            )
        if self.synthesis is not None:
            load_archive_config(self.synthesis)
        elif self.archive not in list_archives() and not os.path.isdir(self.archive):
            raise ConfigError(
                f"archive is {self.archive!r}; it must be a folder or one of"
                f" {', '.join(list_archives())}"
            )
        if self.ppo is not None and load_ppo_settings(self.ppo).level != "duel":  # type: ignore[attr-defined]
            raise ConfigError(f"ppo is {self.ppo!r}; these are no settings of level duel")
        # A subset of them would pass the best of the subset off as the best baseline.
        missing = [name for name in BEST_OPEN_LOOP if name not in self.arms]
        if 0 < len(missing) < len(BEST_OPEN_LOOP):
            present = next(name for name in BEST_OPEN_LOOP if name in self.arms)
            raise ConfigError(
                f"arms hold {present!r} but not {missing[0]!r}; name all of"
                f" {', '.join(BEST_OPEN_LOOP)} or none: the adaptivity gain is over the one that"
                " won most training races"
            )
        if self.best not in self.arms:
            raise ConfigError(
                f"best is {self.best!r}; it must be one of the arms, {', '.join(self.arms)}"
            )
        if 0 < self.pairs * len(self.circuits) < 3:
            raise ConfigError(
                f"pairs is {self.pairs}; networks need at least 3 trees: for training, validation"
                " and test"
            )

    @property
    def tables(self) -> dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], int]]:
        """Tracks, opponents, arms and start lines of each table, by name."""
        tables = {"main": (self.tracks, self.opponents, self.arms, self.lines)}
        if self.further_lines:
            tables["further"] = (
                (*self.tracks, *(name for name in self.further_tracks if name not in self.tracks)),
                (
                    *self.opponents,
                    *(name for name in self.further_opponents if name not in self.opponents),
                ),
                (*self.arms, *(name for name in self.further_arms if name not in self.arms)),
                self.further_lines,
            )
        return tables

    @property
    def every_track(self) -> tuple[str, ...]:
        """All tracks of the study."""
        return tuple(dict.fromkeys((*self.circuits, *self.tracks, *self.further_tracks)))

    @property
    def game(self) -> GameConfig:
        """Rules of the game, with the move "stay" if the race rules have it."""
        race = load_race_config(self.race)
        own = {
            name: getattr(self, name)
            for name in ("epsilon", "moves", "step_seconds", "first_steps")
        }
        return load_game_config(race, **own)


def load_study_config(
    source: str | Path | StudyConfig | None = None, **changes: Any
) -> StudyConfig:
    """Return a configuration from a shipped name, a YAML file or a config, with changed fields."""
    return load_config("study", StudyConfig(), source, **changes)


NETWORK_AGENTS = {
    "cfr-argmax": "regret",
    "cfr-regret-matching": "regret",
    "nash": "nash",
    "ppo": "ppo",
}
"""Targets of the networks of the zoo's agents."""


@dataclass(frozen=True)
class Study:
    """A study with its configuration and folder."""

    config: StudyConfig
    folder: Path
    executor: Executor | None = None  #: Executor of the jobs.
    quiet: bool = False  #: No progress output.

    @cached_property
    def archive(self) -> PolicyArchive:
        """Archive of the study's synthesis, or the archive named by the configuration."""
        return load_archive(
            self.config.archive if self.config.synthesis is None else self.folder / "archive"
        )

    @cached_property
    def spec(self) -> GameSpec:
        """Archive and rules, in the form for agents."""
        return make_game_spec(self.archive, self.config.game)

    def game(self, track: str) -> RaceGame:
        """Return the game on a track."""
        return make_game(self.track(track), self.archive, self.config.game)

    def games(self) -> list[RaceGame]:
        """Return the games on the training tracks."""
        return [self.game(track) for track in self.config.circuits]

    def tree_game(self, track: str) -> RaceGame:
        """Return the trees' game on a track, without "stay" (trees would be six times as large)."""
        return make_game(self.track(track), self.archive, self.config.game, stay=False)

    def track(self, name: str) -> Track:
        """Return a track."""
        return load_track(name)

    def network(self, kind: str) -> Path:
        """Return the folder of a network (or set of networks) trained by this study."""
        return self.folder / "networks" / kind

    def agent(self, name: str) -> Competitor:
        """Return an agent or planner by name, with this study's networks and fits where available.

        The names are the zoo's names and the names in the configuration's ``responses`` (learned
        responses without a margin).
        """
        seed = self.config.seed
        if name in self.config.responses:
            agent = build("cfr-argmax", self.spec, seed=seed, network=self.network(name))
            assert isinstance(agent, Agent)
            return Agent(name, agent.strategy, agent.spec, agent.seed, agent.facts)
        # Networks and fits of this study, once trained, replace shipped networks and fits.
        options: dict[str, Any] = {}
        kind = NETWORK_AGENTS.get(name)
        if name == "adaptive" and self.config.responses:
            options = {
                "network": self.network(self.config.responses[0]),
                "open_loop": self.agent("best-fixed"),
            }
        elif kind is not None and self.network(kind).is_dir():
            options = {"network": self.network(kind)}
        elif name in BEST_OPEN_LOOP:
            options = {"fit": self.folder / "open-loop" / f"{name}.yaml"}
        make = build if options else parse_agent
        return make(name, self.spec, seed=seed, **options)

    def progress(self, unit: str) -> Progress | None:
        """Return a progress function that updates a line on stderr; None if ``quiet``."""
        return None if self.quiet else show_progress(unit)
