"""Declared settings of training by PPO, at the strategy level and at the control level."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcs_racing.base.checks import check_choice, check_path
from pcs_racing.base.errors import ConfigError
from pcs_racing.base.settings import (
    Settings,
    choice,
    load_settings,
    names,
    number,
    read_settings,
    setting,
    text,
    weights,
    whole,
    wholes,
)
from pcs_racing_agents.base.configurations import shipped_configs

TRAINING_TRACKS = ("Tarnfjord", "Vellindra", "Kestrelheim")

_OPPONENTS = weights(1, 1000)
_REWARD_SCALE = "What rewards are multiplied by before they are learned from."


@dataclass(frozen=True, kw_only=True)
class PPOSettings(Settings):
    """Settings that both levels share; the names of PPO's hyperparameters are those of Schulman et al. 2017."""

    tracks: tuple[str, ...] = setting(TRAINING_TRACKS, names(), "Circuits of the training.")
    opponents: Mapping[str, int] = setting({}, _OPPONENTS, "Opponents, and the relative frequency of each.")
    steps: int = setting(1_000_000, whole(1, 10**12), "Maximum number of environment steps for each seed.")
    seeds: tuple[int, ...] = setting(
        (0,),
        wholes(0, 2**31 - 1, shortest=1, different=True),
        "Seeds; one policy is trained with each, and the best is kept.",
    )
    envs: int = setting(64, whole(1, 100_000), "Parallel races for each circuit and set of rules.")
    rollout: int = setting(64, whole(1, 100_000), "Steps of each environment between two updates.")
    batch_size: int = setting(1024, whole(2, 10_000_000), "Environment steps in the batch of a gradient step.")
    epochs: int = setting(8, whole(1, 1000), "Passes over the collected steps in an update.")
    learning_rate: float = setting(1e-3, number(1e-8, 1.0), "Initial learning rate of Adam.")
    final_learning_rate: float = setting(
        1e-4, number(0.0, 1.0), "Final learning rate of Adam; the schedule is linear in the steps."
    )
    discount: float = setting(1.0, number(0.0, 1.0), "Discount factor per step.")
    gae_lambda: float = setting(0.95, number(0.0, 1.0), "Lambda of generalised advantage estimation.")
    clip_range: float = setting(0.2, number(1e-3, 10.0), "Clip range of the probability ratio.")
    entropy: float = setting(0.0, number(0.0, 10.0), "Weight of the entropy in the loss.")
    value_weight: float = setting(0.5, number(0.0, 100.0), "Weight of the value loss.")
    max_gradient: float = setting(0.5, number(1e-6, 1e6), "Maximum norm of a gradient.")
    hidden: tuple[int, ...] = setting((64, 64), wholes(1, 4096, longest=8), "Units of each hidden layer of the policy.")
    value_hidden: tuple[int, ...] = setting(
        (64, 64), wholes(1, 4096, longest=8), "Units of each hidden layer of the value network."
    )
    reward_scale: float = setting(1.0, number(1e-6, 1e6), _REWARD_SCALE)
    evaluate_every: int = setting(50_000, whole(1, 10**12), "Steps between two evaluations.")
    evaluation_races: int = setting(
        200,
        whole(2, 1_000_000),
        "Races of an evaluation on each circuit (and under each set of rules), against the opponents in turn.",
    )
    patience: int = setting(
        0,
        whole(0, 1_000_000),
        "Early stopping: evaluations without an improvement after which training ends; 0 for none.",
    )


@dataclass(frozen=True, kw_only=True)
class DuelSettings(PPOSettings):
    """Settings of training at the strategy level: a step is a move."""

    level: str = setting("duel", choice(("duel",)), "Level of the training.")
    archive: str = setting("default", text(), "Name or folder of the archive of policies.")
    race: str = setting("paper", text(), 'Rules: "paper", "contest" or a YAML file.')
    epsilon: float = setting(0.5, number(1e-6, 10.0), "Length of a move, in units of the archive's range.")
    opponents: Mapping[str, int] = setting(
        {"never-switch": 1},
        _OPPONENTS,
        "never-switch, random-moves, always-MOVE, or drivers such as lane-switcher:3, with relative frequencies.",
    )
    envs: int = setting(64, whole(1, 100_000), "Parallel races for each circuit.")
    rollout: int = setting(16, whole(1, 100_000), "Steps of each environment between two updates.")
    reward_scale: float = setting(0.1, number(1e-6, 1e6), _REWARD_SCALE)


@dataclass(frozen=True, kw_only=True)
class DriveSettings(PPOSettings):
    """Settings of training at the control level: a step is a steering angle and a speed."""

    level: str = setting("drive", choice(("drive",)), "Level of the training.")
    races: tuple[str, ...] = setting(
        ("paper", "contest"),
        names(),
        'Sets of rules: "paper", "contest" or YAML files; races are driven under each of them.',
    )
    opponents: Mapping[str, int] = setting(
        {"lattice": 1}, _OPPONENTS, "Policies such as lattice:pace=0.8, with relative frequencies."
    )
    duration: float = setting(
        16.0, number(0.1, 3600.0), "Length of a race in training, s; evaluations use that of the rules."
    )
    slowest: float = setting(
        0.3,
        number(0.0, 1.0),
        "Speed scale of an opponent's pace 0 in training; 0 for that of the rules. Slow opponents let the agent learn "
        "to overtake; behind an opponent of equal speed the risk is not worth it.",
    )
    hold: int = setting(
        4,
        whole(2, 100),
        "Simulation steps of 0.01 s for which an action holds, an even number; 2 is the 50 Hz of the other planners.",
    )
    rivalry: float = setting(
        0.9,
        number(0.0, 1.0),
        "Share of the opponent's progress that is subtracted from the own progress in the reward: 0 rewards progress, "
        "1 rewards the lead.",
    )
    leading: float = setting(
        2.0,
        number(0.0, 1e6),
        "Reward of a second in front, m. (With a penalty for being behind, a crash would avoid it.)",
    )
    crash_penalty: float = setting(10.0, number(0.0, 1e6), "Penalty for a crash by own fault, m.")
    noise: float = setting(
        0.5,
        number(1e-3, 10.0),
        "Initial standard deviation of the exploration noise of actions, before their tanh.",
    )
    noise_steps: int = setting(
        0,
        whole(0, 10_000),
        "Steps between two draws of the exploration noise, which depends on the state (gSDE, Raffin et al. 2021); "
        "0 draws independent noise in each step.",
    )
    discount: float = setting(0.998, number(0.0, 1.0), "Discount factor per step.")
    reward_scale: float = setting(0.1, number(1e-6, 1e6), _REWARD_SCALE)
    steps: int = setting(5_000_000, whole(1, 10**12), "Maximum number of environment steps for each seed.")
    rollout: int = setting(128, whole(1, 100_000), "Steps of each environment between two updates.")
    evaluate_every: int = setting(500_000, whole(1, 10**12), "Steps between two evaluations.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hold % 2:
            raise ConfigError(f"hold is {self.hold}; it must be even: drivers are asked every second simulation step")


LEVELS: dict[str, PPOSettings] = {"duel": DuelSettings(), "drive": DriveSettings()}
"""Default settings, by level."""


def load_ppo_settings(source: str | Path | PPOSettings, **changes: Any) -> PPOSettings:
    """Return settings from a shipped configuration's name, a YAML file or settings, with some fields changed.

    A file names its ``level`` ("duel" or "drive") beside the fields of :class:`DuelSettings` or :class:`DriveSettings`.
    """
    if isinstance(source, PPOSettings):
        return load_settings("ppo", source, None, **changes)
    shipped, default = shipped_configs("ppo"), LEVELS["duel"]
    path = shipped.get(str(check_path("settings", source, ConfigError)), source)
    if os.path.isfile(path):
        level = read_settings(path).get("level")
        default = LEVELS[check_choice(f"{path}: level", level, LEVELS, ConfigError)]
    return load_settings("ppo", default, source, shipped, **changes)
