"""Settings of PPO training; a step is a move."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval, Len, MinLen

from pcs_racing.base.settings import (
    DIFFERENT,
    Layers,
    Names,
    Settings,
    Text,
    load_settings,
)
from pcs_racing_agents.base.configurations import shipped_configs

TRAINING_TRACKS = ("Tarnfjord", "Vellindra", "Kestrelheim")

_Weights = Annotated[Mapping[Text, Annotated[int, Interval(ge=1, le=1000)]], MinLen(1)]


@dataclass(frozen=True, kw_only=True)
class DuelSettings(Settings):
    """Settings of training in the duel; hyperparameters are named as in Schulman et al. 2017."""

    archive: Annotated[Text, "Name or folder of the archive of policies."] = "default"
    rules: Annotated[Text, 'Rules: "paper", "contest" or a YAML file.'] = "paper"
    epsilon: Annotated[
        float, Interval(ge=1e-6, le=10.0), "Length of a move, in units of the archive's range."
    ] = 0.5
    tracks: Annotated[Names, "Circuits of the training."] = TRAINING_TRACKS
    opponents: Annotated[
        _Weights,
        "never-switch, random-moves, always-MOVE, or planners such as lane-switcher:3, with"
        " relative frequencies.",
    ] = field(default_factory=lambda: {"never-switch": 1}, hash=False)
    steps: Annotated[
        int, Interval(ge=1, le=10**12), "Maximum number of environment steps for each seed."
    ] = 1_000_000
    seeds: Annotated[
        tuple[Annotated[int, Interval(ge=0, le=2**31 - 1)], ...],
        Len(1, 1000),
        DIFFERENT,
        "Seeds; one policy is trained with each, and the best is kept.",
    ] = (0,)
    envs: Annotated[int, Interval(ge=1, le=100_000), "Parallel races for each circuit."] = 64
    rollout: Annotated[
        int, Interval(ge=1, le=100_000), "Steps of each environment between two updates."
    ] = 16
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
    reward_scale: Annotated[
        float, Interval(ge=1e-6, le=1e6), "Factor of the rewards in learning."
    ] = 0.1
    evaluate_every: Annotated[int, Interval(ge=1, le=10**12), "Steps between two evaluations."] = (
        50_000
    )
    evaluation_races: Annotated[
        int,
        Interval(ge=2, le=1_000_000),
        "Races of an evaluation on each circuit, against the opponents by equal shares.",
    ] = 200
    patience: Annotated[
        int,
        Interval(ge=0, le=1_000_000),
        "Early stopping: evaluations without an improvement after which training ends; 0 for none.",
    ] = 0


def load_ppo_settings(source: str | Path | DuelSettings, **changes: Any) -> DuelSettings:
    """Return settings from a name, a YAML file or settings, with changed fields."""
    return load_settings("ppo", DuelSettings(), source, shipped_configs("ppo"), **changes)
