"""Settings of PPO training at the strategy level and at the control level."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval, Len, MinLen

from pcs_racing.base.checks import check_choice, check_path
from pcs_racing.base.errors import ConfigError
from pcs_racing.base.settings import (
    DIFFERENT,
    Layers,
    Names,
    OneOf,
    Settings,
    Text,
    load_settings,
    read_settings,
)
from pcs_racing_agents.base.configurations import shipped_configs

TRAINING_TRACKS = ("Tarnfjord", "Vellindra", "Kestrelheim")

_Weights = Annotated[Mapping[Text, Annotated[int, Interval(ge=1, le=1000)]], MinLen(1)]
_REWARD_SCALE = "What rewards are multiplied by before they are learned from."


@dataclass(frozen=True, kw_only=True)
class PPOSettings(Settings):
    """Settings of both levels; hyperparameters of PPO are named as in Schulman et al. 2017."""

    tracks: Annotated[Names, "Circuits of the training."] = TRAINING_TRACKS
    opponents: Annotated[
        _Weights,
        "Opponents, and the relative frequency of each.",
    ] = field(default_factory=dict, hash=False)
    steps: Annotated[
        int, Interval(ge=1, le=10**12), "Maximum number of environment steps for each seed."
    ] = 1_000_000
    seeds: Annotated[
        tuple[Annotated[int, Interval(ge=0, le=2**31 - 1)], ...],
        Len(1, 1000),
        DIFFERENT,
        "Seeds; one policy is trained with each, and the best is kept.",
    ] = (0,)
    envs: Annotated[
        int, Interval(ge=1, le=100_000), "Parallel races for each circuit and set of rules."
    ] = 64
    rollout: Annotated[
        int, Interval(ge=1, le=100_000), "Steps of each environment between two updates."
    ] = 64
    batch_size: Annotated[
        int,
        Interval(ge=2, le=10_000_000),
        "Environment steps in the batch of a gradient step.",
    ] = 1024
    epochs: Annotated[
        int, Interval(ge=1, le=1000), "Passes over the collected steps in an update."
    ] = 8
    learning_rate: Annotated[float, Interval(ge=1e-8, le=1.0), "Initial learning rate of Adam."] = (
        1e-3
    )
    final_learning_rate: Annotated[
        float,
        Interval(ge=0.0, le=1.0),
        "Final learning rate of Adam; the schedule is linear in the steps.",
    ] = 1e-4
    discount: Annotated[float, Interval(ge=0.0, le=1.0), "Discount factor per step."] = 1.0
    gae_lambda: Annotated[
        float, Interval(ge=0.0, le=1.0), "Lambda of generalised advantage estimation."
    ] = 0.95
    entropy: Annotated[float, Interval(ge=0.0, le=10.0), "Weight of the entropy in the loss."] = 0.0
    hidden: Annotated[Layers, "Units of each hidden layer of the policy."] = (64, 64)
    value_hidden: Annotated[Layers, "Units of each hidden layer of the value network."] = (64, 64)
    reward_scale: Annotated[float, Interval(ge=1e-6, le=1e6), _REWARD_SCALE] = 1.0
    evaluate_every: Annotated[int, Interval(ge=1, le=10**12), "Steps between two evaluations."] = (
        50_000
    )
    evaluation_races: Annotated[
        int,
        Interval(ge=2, le=1_000_000),
        "Races of an evaluation on each circuit (and under each set of rules), against the"
        " opponents by equal shares.",
    ] = 200
    patience: Annotated[
        int,
        Interval(ge=0, le=1_000_000),
        "Early stopping: evaluations without an improvement after which training ends; 0 for none.",
    ] = 0


@dataclass(frozen=True, kw_only=True)
class DuelSettings(PPOSettings):
    """Settings of training at the strategy level; a step is a move."""

    level: Annotated[str, OneOf(("duel",)), "Level of the training."] = "duel"
    archive: Annotated[Text, "Name or folder of the archive of policies."] = "default"
    race: Annotated[Text, 'Rules: "paper", "contest" or a YAML file.'] = "paper"
    epsilon: Annotated[
        float, Interval(ge=1e-6, le=10.0), "Length of a move, in units of the archive's range."
    ] = 0.5
    opponents: Annotated[
        _Weights,
        "never-switch, random-moves, always-MOVE, or planners such as lane-switcher:3, with"
        " relative frequencies.",
    ] = field(default_factory=lambda: {"never-switch": 1}, hash=False)
    envs: Annotated[int, Interval(ge=1, le=100_000), "Parallel races for each circuit."] = 64
    rollout: Annotated[
        int, Interval(ge=1, le=100_000), "Steps of each environment between two updates."
    ] = 16
    reward_scale: Annotated[float, Interval(ge=1e-6, le=1e6), _REWARD_SCALE] = 0.1


@dataclass(frozen=True, kw_only=True)
class DriveSettings(PPOSettings):
    """Settings of training at the control level; an action is a steering angle and a speed."""

    level: Annotated[str, OneOf(("drive",)), "Level of the training."] = "drive"
    races: Annotated[
        Names,
        'Sets of rules: "paper", "contest" or YAML files; races are driven under each of them.',
    ] = ("paper", "contest")
    opponents: Annotated[
        _Weights,
        "Policies such as lattice:pace=0.8, with relative frequencies.",
    ] = field(default_factory=lambda: {"lattice": 1}, hash=False)
    duration: Annotated[
        float,
        Interval(ge=0.1, le=3600.0),
        "Length of a race in training, s; evaluations use the length of the rules.",
    ] = 16.0
    slowest: Annotated[
        float,
        Interval(ge=0.0, le=1.0),
        "Speed scale of an opponent's pace 0 in training; 0 for the scale of the rules. Slow"
        " opponents let the agent learn to overtake; behind an opponent of equal speed the risk is"
        " not worth it.",
    ] = 0.3
    hold: Annotated[
        int,
        Interval(ge=2, le=100),
        "Simulation steps of 0.01 s for which an action holds, an even number; 2 is the 50 Hz of"
        " the other planners.",
    ] = 4
    rivalry: Annotated[
        float,
        Interval(ge=0.0, le=1.0),
        "Share of the opponent's progress that is subtracted from the own progress in the reward: 0"
        " rewards progress, 1 rewards the lead.",
    ] = 0.9
    crash_penalty: Annotated[
        float, Interval(ge=0.0, le=1e6), "Penalty for a crash by own fault, m."
    ] = 10.0
    noise: Annotated[
        float,
        Interval(ge=1e-3, le=10.0),
        "Initial standard deviation of the exploration noise of actions, before their tanh.",
    ] = 0.5
    # A step is cheap, and large batches make the networks cheap: docs/ppo.md has the figures.
    envs: Annotated[
        int, Interval(ge=1, le=100_000), "Parallel races for each circuit and set of rules."
    ] = 85
    rollout: Annotated[
        int, Interval(ge=1, le=100_000), "Steps of each environment between two updates."
    ] = 32
    batch_size: Annotated[
        int,
        Interval(ge=2, le=10_000_000),
        "Environment steps in the batch of a gradient step.",
    ] = 8192
    epochs: Annotated[
        int, Interval(ge=1, le=1000), "Passes over the collected steps in an update."
    ] = 4
    discount: Annotated[float, Interval(ge=0.0, le=1.0), "Discount factor per step."] = 0.998
    reward_scale: Annotated[float, Interval(ge=1e-6, le=1e6), _REWARD_SCALE] = 0.1
    steps: Annotated[
        int, Interval(ge=1, le=10**12), "Maximum number of environment steps for each seed."
    ] = 5_000_000
    evaluate_every: Annotated[int, Interval(ge=1, le=10**12), "Steps between two evaluations."] = (
        500_000
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hold % 2:
            raise ConfigError(
                f"hold is {self.hold}; it must be even: planners are asked every second simulation"
                " step"
            )


LEVELS: dict[str, PPOSettings] = {"duel": DuelSettings(), "drive": DriveSettings()}
"""Default settings, by level."""


def load_ppo_settings(source: str | Path | PPOSettings, **changes: Any) -> PPOSettings:
    """Return settings from a shipped config's name, a YAML file or settings, with changed fields.

    A file contains its ``level`` ("duel" or "drive") and fields of :class:`DuelSettings` or
    :class:`DriveSettings`.
    """
    if isinstance(source, PPOSettings):
        return load_settings("ppo", source, None, **changes)
    shipped, default = shipped_configs("ppo"), LEVELS["duel"]
    path = shipped.get(str(check_path("settings", source, ConfigError)), source)
    if os.path.isfile(path):
        level = read_settings(path).get("level")
        default = LEVELS[check_choice(f"{path}: level", level, LEVELS, ConfigError)]
    return load_settings("ppo", default, source, shipped, **changes)
