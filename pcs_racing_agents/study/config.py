"""Configuration of a study: rules, learning, races of the tables."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from pcs_racing.base.errors import ConfigError
from pcs_racing.base.settings import Checked, Names, OptionalNames, Settings, Text
from pcs_racing.game.archive_files import list_archives
from pcs_racing.race.config import PAPER, Rules, load_rules
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.learning.responses import load_response_settings
from pcs_racing_agents.learning.self_play import load_self_play_settings
from pcs_racing_agents.networks.rows import get_target

BASELINES = ("best-fixed", "best-schedule", "best-lead-plan")
"""Agents fitted on training races: fixed policy, move sequence and lead-conditioned plan."""


@dataclass(frozen=True)
class LearningConfig(Settings):
    """Game trees, networks, baselines and responses of a study."""

    tracks: Annotated[Names, "Training tracks, also of the game trees."] = ("Tarnfjord",)
    targets: Annotated[
        OptionalNames, "Targets of networks trained on game trees; none for no trees."
    ] = ("regret",)
    trees: Annotated[int, Interval(ge=3, le=100_000), "Game trees on each track."] = 12
    training: Annotated[Text, "Configuration of the training on trees."] = "study"
    sampled_cfr: Annotated[
        Text | None,
        "Configuration (self-play) of counterfactual regrets from sampled games, for cfr-argmax"
        " and cfr-regret-matching in place of regrets from trees; None for none.",
    ] = None
    responses: Annotated[
        OptionalNames,
        "Configurations of learned responses"
        " (pcs_racing_agents.learning.responses.ResponseSettings).",
    ] = ()
    response_opponents: Annotated[Names, "Opponents in the training of responses."] = (
        "never-switch",
        "random-moves",
    )
    fitting_races: Annotated[
        int,
        Interval(ge=2, le=1_000_000),
        "Races against each opponent on each track, to select the baselines; even.",
    ] = 100
    fitting_opponents: Annotated[Names, "Opponents in those races."] = ("never-switch",)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.targets:
            get_target(name)
        for name in self.responses:
            load_response_settings(name)
        if self.sampled_cfr is not None:
            load_self_play_settings(self.sampled_cfr)
            if "regret" in self.targets:
                raise ConfigError(
                    f"sampled_cfr is {self.sampled_cfr!r} and targets hold 'regret'; name one"
                    " source of the regrets"
                )

    @property
    def networks(self) -> tuple[str, ...]:
        """Kinds of networks of the zoo's agents that the study trains."""
        return self.targets if self.sampled_cfr is None else (*self.targets, "regret")


@dataclass(frozen=True)
class TableConfig(Settings):
    """Races of a table: each agent against each opponent on each track."""

    tracks: Annotated[Names, "Tracks of the table."] = ("Tarnfjord",)
    opponents: Annotated[Names, "Opponents of the table."] = (
        "never-switch",
        "random-policy",
        "lane-switcher:any",
    )
    agents: Annotated[Names, "Agents of the table; the first is the base of the differences."] = (
        "never-switch",
        *BASELINES,
        "cfr-argmax",
    )
    egos: Annotated[int, Interval(ge=2, le=1000), "Start policies of the ego in each cell."] = 20
    variants: Annotated[int, Interval(ge=2, le=1000), "Variants of the opponent in each cell."] = 20
    lines: Annotated[
        int, Interval(ge=1, le=1000), "Start lines of each cell; races start from both sides."
    ] = 5


def _rules(_: str, value: Any) -> Rules:
    return load_rules(value)


@dataclass(frozen=True)
class StudyConfig(Settings):
    """Configuration of a study; it determines the results."""

    rules: Annotated[Rules, Checked(_rules), "Rules: a name, a YAML file or their fields."] = PAPER
    archive: Annotated[Text, "Name or folder of the policy archive."] = "default"
    learning: Annotated[LearningConfig, "Training of the networks and agents."] = LearningConfig()
    table: Annotated[
        TableConfig,
        "Main table, with the adaptivity gain if all baselines (best-fixed, best-schedule,"
        " best-lead-plan) are among its agents.",
    ] = TableConfig()
    further: Annotated[
        TableConfig | None,
        "Second table, of more opponents, tracks and agents; None for none.",
    ] = None
    best: Annotated[Text, "Agent of main interest in the tables."] = "cfr-argmax"
    seed: Annotated[int, Interval(ge=0, le=2**62), "Seed of all random draws."] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rules.laps is not None and self.learning.targets:
            raise ConfigError(
                f"laps is {self.rules.laps}; game trees need races by time: leave targets empty"
            )
        if self.archive not in list_archives() and not os.path.isdir(self.archive):
            raise ConfigError(
                f"archive is {self.archive!r}; it must be a folder or one of"
                f" {', '.join(list_archives())}"
            )
        for table in self.tables:
            if self.best not in table.agents:
                raise ConfigError(
                    f"best is {self.best!r}; it must be one of the agents,"
                    f" {', '.join(table.agents)}"
                )

    @property
    def tables(self) -> tuple[TableConfig, ...]:
        """Main table, and the second one if there is one."""
        return (self.table,) if self.further is None else (self.table, self.further)

    @property
    def tracks(self) -> tuple[str, ...]:
        """All tracks of the study."""
        tables = (name for table in self.tables for name in table.tracks)
        return tuple(dict.fromkeys((*self.learning.tracks, *tables)))


def load_study_config(
    source: str | Path | StudyConfig | None = None, **changes: Any
) -> StudyConfig:
    """Return a configuration from a shipped name, a YAML file or a config, with changed fields."""
    return load_config("study", StudyConfig(), source, **changes)
