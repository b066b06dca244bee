"""How a driver or a strategy is trained by PPO: dataclasses, from YAML if need be."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import ConfigError
from pcs_racing_agents.jobs.configuration import (
    check_numbers,
    check_source,
    check_wholes,
    load_settings,
    read_mapping,
    shipped_configs,
)

__all__ = ["LEVELS", "DriveSettings", "DuelSettings", "Settings", "load_ppo_settings"]

TRAINING_TRACKS = ("Tarnfjord", "Vellindra", "Kestrelheim")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What both levels have in common; the names of PPO's hyperparameters are those of Schulman et al. 2017.

    Attributes
    ----------
    tracks : tuple of str
        Circuits to learn on.
    opponents : mapping of str to int
        Who drives car 1, and how often in relation to the others.
    steps : int
        Steps of the environment to learn from, at most, for each seed.
    seeds : tuple of int
        One training for each of them; the best one is kept.
    envs : int
        Races that are driven side by side, for each circuit and set of rules.
    rollout : int
        Steps of each of them between two updates.
    batch_size : int
    epochs : int
        Passes over what was seen, per update.
    learning_rate, final_learning_rate : float
        Of Adam; falls in a straight line over ``steps``.
    discount : float
        Per step.
    gae_lambda : float
    clip_range : float
    entropy, value_weight : float
        Weights in the loss.
    max_gradient : float
        Norm to which gradients are cut.
    hidden, value_hidden : tuple of int
        Widths of the hidden layers of the policy, and of the network that judges situations.
    reward_scale : float
        What rewards are multiplied by before they are learned from.
    evaluate_every : int
        Steps between two evaluations.
    evaluation_races : int
        Races of an evaluation on each circuit (and under each set of rules), against the opponents in turn.
    patience : int
        Training ends at a plateau: after so many evaluations without a better one. 0 never ends it.

    Raises
    ------
    ConfigError
        If a value is impossible.
    """

    tracks: tuple[str, ...] = TRAINING_TRACKS
    opponents: Mapping[str, int] = field(default_factory=dict, hash=False)
    steps: int = 1_000_000
    seeds: tuple[int, ...] = (0,)
    envs: int = 64
    rollout: int = 64
    batch_size: int = 1024
    epochs: int = 8
    learning_rate: float = 1e-3
    final_learning_rate: float = 1e-4
    discount: float = 1.0
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    entropy: float = 0.0
    value_weight: float = 0.5
    max_gradient: float = 0.5
    hidden: tuple[int, ...] = (64, 64)
    value_hidden: tuple[int, ...] = (64, 64)
    reward_scale: float = 1.0
    evaluate_every: int = 50_000
    evaluation_races: int = 200
    patience: int = 0

    def __post_init__(self) -> None:
        _check_texts(self, "tracks")
        for name, weight in _mapping(self, "opponents").items():
            whole = isinstance(weight, int) and not isinstance(weight, bool)
            if not isinstance(name, str) or not name or not whole or not 1 <= weight <= 1000:
                raise ConfigError(f"opponents holds {name!r}: {weight!r}; give names with whole numbers from 1 to 1000")
        check_wholes(
            self,
            steps=(1, 10**12),
            envs=(1, 100_000),
            rollout=(1, 100_000),
            batch_size=(2, 10_000_000),
            epochs=(1, 1000),
            evaluate_every=(1, 10**12),
            evaluation_races=(2, 1_000_000),
            patience=(0, 1_000_000),
        )
        check_numbers(
            self,
            learning_rate=(1e-8, 1.0),
            final_learning_rate=(0.0, 1.0),
            discount=(0.0, 1.0),
            gae_lambda=(0.0, 1.0),
            clip_range=(1e-3, 10.0),
            entropy=(0.0, 10.0),
            value_weight=(0.0, 100.0),
            max_gradient=(1e-6, 1e6),
            reward_scale=(1e-6, 1e6),
        )
        _check_list(self, "seeds", 1, 1000, 0, 2**31 - 1)
        if len(set(self.seeds)) < len(self.seeds):
            raise ConfigError(f"seeds is {list(self.seeds)}; each must be there once")
        for key in ("hidden", "value_hidden"):
            _check_list(self, key, 0, 8, 1, 4096)


@dataclass(frozen=True, kw_only=True)
class DuelSettings(Settings):
    """Training at the level of strategy: a step is a move, of which a game has few.

    Attributes
    ----------
    level : str
        "duel".
    archive : str
        Name or folder of the archive of policies.
    race : str
        Rules: "paper", "contest" or a YAML file.
    epsilon : float
        How far a move goes, in units of the archive's range.
    opponents
        ``never-switch``, ``random-moves``, ``always-MOVE``, or drivers such as ``lane-switcher:3``.
    """

    level: str = "duel"
    archive: str = "default"
    race: str = "paper"
    epsilon: float = 0.5
    opponents: Mapping[str, int] = field(default_factory=lambda: {"never-switch": 1}, hash=False)
    envs: int = 64
    rollout: int = 16
    reward_scale: float = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_text(self, "archive")
        _check_text(self, "race")
        check_numbers(self, epsilon=(1e-6, 10.0))


@dataclass(frozen=True, kw_only=True)
class DriveSettings(Settings):
    """Training at the level of control: a step is a steering angle and a speed.

    Attributes
    ----------
    level : str
        "drive".
    races : tuple of str
        Sets of rules: "paper", "contest" or YAML files; races are driven under each of them.
    opponents
        Policies such as ``lattice:pace=0.8``.
    duration : float
        Length of a race in training, s. Evaluations take that of the rules.
    slowest : float
        Speed scale that stands for an opponent's pace 0 in training; 0 for that of the rules. From slow opponents a
        learner finds out how to pass: behind one of its own speed the risk does not pay.
    hold : int
        Simulation steps of 0.01 s for which an action holds, an even number; 2 is the 50 Hz of the other planners.
    rivalry : float
        Share of the opponent's progress that is taken off the own one in the reward: 0 for a lap record, 1 for nothing
        but the lead.
    leading : float
        What a second in front is worth in the reward, m. (Were one behind to cost, a crash would be a way out.)
    crash_penalty : float
        What a crash by own fault costs, m.
    noise : float
        Standard deviation with which actions (before their ``tanh``) are explored at first.
    noise_steps : int
        Steps for which exploration goes in one direction, as a function of the situation (gSDE, Raffin et al. 2021); 0
        draws independent noise in each step.
    """

    level: str = "drive"
    races: tuple[str, ...] = ("paper", "contest")
    opponents: Mapping[str, int] = field(default_factory=lambda: {"lattice": 1}, hash=False)
    duration: float = 16.0
    slowest: float = 0.3
    hold: int = 4
    rivalry: float = 0.9
    leading: float = 2.0
    crash_penalty: float = 10.0
    noise: float = 0.5
    noise_steps: int = 0
    discount: float = 0.998
    reward_scale: float = 0.1
    steps: int = 5_000_000
    rollout: int = 128
    evaluate_every: int = 500_000

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_texts(self, "races")
        check_wholes(self, hold=(2, 100), noise_steps=(0, 10_000))
        if self.hold % 2:
            raise ConfigError(f"hold is {self.hold}; it must be even: drivers are asked every second simulation step")
        check_numbers(
            self,
            duration=(0.1, 3600.0),
            slowest=(0.0, 1.0),
            rivalry=(0.0, 1.0),
            leading=(0.0, 1e6),
            crash_penalty=(0.0, 1e6),
            noise=(1e-3, 10.0),
        )


def load_ppo_settings(source: str | Path | Settings, **changes: Any) -> Settings:
    """Return settings from a shipped configuration's name, a YAML file or settings, with some fields changed.

    A file names its ``level`` ("duel" or "drive") beside the fields of :class:`DuelSettings` or :class:`DriveSettings`.

    Raises
    ------
    ConfigError
        If a key is unknown or a value impossible.
    UnknownNameError
        If the name is no configuration and no file.
    """
    if isinstance(source, Settings):
        return load_settings("ppo", source, None, **changes)
    check_source("ppo", source)
    shipped = shipped_configs("ppo")
    path = shipped.get(str(source), Path(source))
    if not os.path.isfile(path):
        load_settings("ppo", LEVELS["duel"], source)  # says what there is
    level = read_mapping(path).get("level")
    if not isinstance(level, str) or level not in LEVELS:
        raise ConfigError(f"{path}: level is {level!r}; it must be {' or '.join(LEVELS)}")
    return load_settings("ppo", LEVELS[level], path, **changes)


def _check_text(settings: Any, key: str) -> None:
    if not isinstance(getattr(settings, key), str) or not getattr(settings, key):
        raise ConfigError(f"{key} is {getattr(settings, key)!r}; it must be a name or a path")


def _check_texts(settings: Any, key: str) -> None:
    values = getattr(settings, key)
    fine = isinstance(values, tuple) and values and all(isinstance(value, str) and value for value in values)
    if not fine or len(set(values)) < len(values):
        raise ConfigError(f"{key} is {values!r}; it must be a list of different names")


def _check_list(settings: Any, key: str, least: int, most: int, low: int, high: int) -> None:
    values = getattr(settings, key)
    whole = isinstance(values, tuple) and all(
        isinstance(value, int) and not isinstance(value, bool) for value in values
    )
    if not whole or not least <= len(values) <= most or not all(low <= value <= high for value in values):
        raise ConfigError(
            f"{key} is {values!r}; it must be a list of {least} to {most} whole numbers from {low} to {high}"
        )


def _mapping(settings: Any, key: str) -> Mapping[Any, Any]:
    values = getattr(settings, key)
    if not isinstance(values, Mapping) or not values:
        raise ConfigError(f"{key} is {values!r}; it must be a mapping of names to how often they are met")
    return values


LEVELS: dict[str, Settings] = {"duel": DuelSettings(), "drive": DriveSettings()}
"""Settings that a file's are filled up with, by its ``level``."""
