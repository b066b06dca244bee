"""Domain randomisation: ranges from which each episode draws its friction, mass, steering and sensor noise."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import is_number
from pcs_racing.base.errors import ConfigError
from pcs_racing.base.settings import Rule, Settings, load_settings, setting
from pcs_racing.car.vehicle import COMMAND_PERIOD, MOST_DELAYED, VehicleParams


def range_rule(what: str, least: float, most: float, is_kind: Callable[[Any], bool] = is_number) -> Rule:
    """Two numbers within limits, the second one not below the first; a single number stands for both."""

    def check(name: str, value: Any) -> tuple[Any, Any]:
        pair = [value, value] if is_kind(value) else value
        fine = isinstance(pair, list | tuple) and len(pair) == 2 and all(map(is_kind, pair))
        if not fine or not least <= pair[0] <= pair[1] <= most:
            raise ConfigError(
                f"{name}{what} is {value!r}; it must be [low, high] with {least:g} <= low <= high <= {most:g}"
            )
        kind = float if is_kind is is_number else int
        return kind(pair[0]), kind(pair[1])

    return Rule(check, f"[low, high] from {least:g} to {most:g}")


@dataclass(frozen=True)
class Randomization(Settings):
    """What each episode draws, uniformly, for both cars; None leaves it as it is."""

    friction: tuple[float, float] | None = setting(None, range_rule("", 0.05, 5.0), "Friction coefficient.")
    mass: tuple[float, float] | None = setting(
        None, range_rule("", 0.1, 1000.0), "Mass, kg; the yaw inertia changes in the same proportion."
    )
    steering_delay: tuple[float, float] | None = setting(
        None,
        range_rule("", 0.0, MOST_DELAYED * COMMAND_PERIOD),
        "Time by which steering commands are late, s; of its multiples of 0.02 s each is as likely.",
    )
    steering_noise: tuple[float, float] | None = setting(
        None,
        range_rule("", 0.0, 0.4),
        "Standard deviation of the disturbance of every steering command, in place of that of the rules, rad.",
    )
    lidar_noise: tuple[float, float] | None = setting(
        None, range_rule("", 0.0, 10.0), "Standard deviation of the lidar's ranges, m; only where there is a lidar."
    )

    @property
    def names(self) -> tuple[str, ...]:
        """What is drawn, in the order in which it is drawn."""
        return tuple(field.name for field in fields(self) if getattr(self, field.name) is not None)

    @property
    def most_delay(self) -> float:
        """Longest steering delay, s."""
        return 0.0 if self.steering_delay is None else self._delays[-1] * COMMAND_PERIOD

    @property
    def _delays(self) -> NDArray[np.int64]:
        low, high = self.steering_delay or (0.0, 0.0)
        # Multiples of 0.02 s are hardly ever exact in floating point; 1e-9 is no other delay.
        first, last = np.ceil(low / COMMAND_PERIOD - 1e-9), np.floor(high / COMMAND_PERIOD + 1e-9)
        return np.arange(int(first), int(last) + 1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.steering_delay is not None and len(self._delays) == 0:
            raise ConfigError(
                f"steering_delay is {self.steering_delay!r}; there is no multiple of {COMMAND_PERIOD:g} s in between"
            )

    def draw(self, generator: np.random.Generator) -> dict[str, float]:
        """Draw the values of an episode, by name."""
        drawn = {}
        for name in self.names:
            if name == "steering_delay":
                delays = self._delays
                drawn[name] = float(round(int(delays[generator.integers(len(delays))]) * COMMAND_PERIOD, 2))
            else:
                low, high = getattr(self, name)
                drawn[name] = float(low + (high - low) * generator.random())
        return drawn

    @staticmethod
    def apply(vehicle: VehicleParams, drawn: Mapping[str, float]) -> VehicleParams:
        """Return a car with drawn values."""
        changes: dict[str, Any] = {}
        if "friction" in drawn:
            changes["mu"] = drawn["friction"]
        if "mass" in drawn:
            changes |= {"m": drawn["mass"], "inertia": vehicle.inertia * (drawn["mass"] / vehicle.m)}
        if "steering_delay" in drawn:
            changes["steer_delay"] = drawn["steering_delay"]
        if "steering_noise" in drawn:
            changes["steer_noise"] = drawn["steering_noise"]
        return replace(vehicle, **changes)


def load_randomization(source: Randomization | Mapping[str, Any] | str | Path | None) -> Randomization:
    """Return ranges, a mapping of them or those of a YAML file as settings; None for none.

    Examples
    --------
    >>> load_randomization({"friction": [0.8, 1.1]}).names
    ('friction',)
    """
    return load_settings("randomization", Randomization(), source)
