"""Settings of restricted Nash responses and of policy-space response oracles."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pcs_racing.base.settings import Settings, number, setting, text, whole
from pcs_racing_agents.jobs.configuration import load_config
from pcs_racing_agents.learning.responses.learner import ResponseSettings, load_response_settings


@dataclass(frozen=True)
class _ResponsesSettings(Settings):
    """What the settings of agents that are made of several learned responses share."""

    learner: str = setting(
        "robust", text(), "Settings of each learned response (response configuration: a name or a YAML file)."
    )
    seed: int = setting(0, whole(0, 2**40), "Seed of the games and of the networks.")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.response(0)

    def response(self, number: int) -> ResponseSettings:
        """Return the settings of one of the responses, each with a seed of its own."""
        settings = load_response_settings(self.learner)
        return replace(settings, seed=settings.seed + self.seed * 64 + number)


@dataclass(frozen=True)
class RobustSettings(_ResponsesSettings):
    """Settings of a restricted Nash response."""

    pool_share: float = setting(
        0.75,
        number(0.0, 1.0),
        "Share of the games against the pool; the others are against adversaries. 1 is the response to the pool.",
    )
    rounds: int = setting(4, whole(1, 20), "Adversaries that are learned, each followed by a response.")


@dataclass(frozen=True)
class PSROSettings(_ResponsesSettings):
    """Settings of policy-space response oracles."""

    rounds: int = setting(6, whole(2, 32), "Responses that are learned.")
    races: int = setting(200, whole(2, 2000), "Races of each two responses on each circuit, for the equilibrium; even.")


def load_robust_settings(source: str | Path | RobustSettings | None = None, **changes: Any) -> RobustSettings:
    """Return settings from a name, a YAML file or settings, with some fields changed; see :func:`load_config`."""
    return load_config("robust", RobustSettings(), source, **changes)


def load_psro_settings(source: str | Path | PSROSettings | None = None, **changes: Any) -> PSROSettings:
    """Return settings from a name, a YAML file or settings, with some fields changed; see :func:`load_config`."""
    return load_config("psro", PSROSettings(), source, **changes)
