"""Observations of an environment of generation B, and their spaces."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from pcs_racing.base.errors import ConfigError, check_names
from pcs_racing.f1tenth import kernel as k
from pcs_racing.f1tenth.simulator import RANGE

FEATURES = (
    "scan",
    "pose_x",
    "pose_y",
    "pose_theta",
    "linear_vel_x",
    "linear_vel_y",
    "ang_vel_z",
    "delta",
    "beta",
    "collision",
    "lap_time",
    "lap_count",
)
_KINEMATIC = ("pose_x", "pose_y", "delta", "linear_vel_x", "pose_theta")
TYPES: dict[str, tuple[str, ...]] = {
    "kinematic_state": _KINEMATIC,
    "dynamic_state": (*_KINEMATIC, "ang_vel_z", "beta"),
    "frenet_dynamic_state": (*_KINEMATIC[:4], "linear_vel_y", "pose_theta", "ang_vel_z", "beta"),
}
_LARGE = 1e30

Observe = Callable[[Any], dict[str, Any]]  # argument: cars with the reported laps


def observation(env: Any, config: Any) -> tuple[spaces.Space[Any], Observe]:
    """Return the space and the observation function of an ``observation_config``."""
    if not isinstance(config, Mapping) or "type" not in config:
        raise ConfigError(
            f"observation_config is {config!r:.200}; it must be a dictionary with a 'type'"
        )
    kind = config["type"] or "original"
    if kind == "original":
        return _original_space(env.num_agents, env.sim.lidar.beams), lambda laps: _original(
            env, laps
        )
    if kind == "features":
        features = check_names(
            "observation_config: features", config.get("features"), error=ConfigError
        )
        for name in features:
            if name not in FEATURES:
                raise ConfigError(
                    f"observation_config: features holds {name!r:.80}; there are"
                    f" {', '.join(FEATURES)}"
                )
    elif isinstance(kind, str) and kind in TYPES:
        features = TYPES[kind]
    else:
        known = ", ".join(["original", "features", *TYPES])
        raise ConfigError(f"observation_config: type is {kind!r:.80}; it must be one of {known}")
    one = {name: _bounds(name, env.sim.lidar.beams) for name in features}
    return spaces.Dict({name: spaces.Dict(one) for name in env.agent_ids}), lambda laps: _features(
        env, laps, features
    )


def _box(low: float, high: float, *shape: int) -> spaces.Space[Any]:
    return spaces.Box(low, high, shape, np.float32)


def _bounds(name: str, beams: int, *cars: int) -> spaces.Space[Any]:
    """Return the space of a feature, or of an original quantity of all cars."""
    if name.startswith("scan"):
        return _box(0.0, RANGE + 0.5 * len(cars), *cars, beams)
    return _box(
        0.0 if name[:3] in ("col", "lap") else -_LARGE, 1.0 if name[:3] == "col" else _LARGE, *cars
    )


def _original_space(cars: int, beams: int) -> spaces.Dict:
    names = ("scans", "linear_vels_y", "lap_times", "lap_counts", *k.ORIGINAL)
    return spaces.Dict(
        {"ego_idx": spaces.Discrete(cars)} | {name: _bounds(name, beams, cars) for name in names}
    )


def _original(env: Any, laps: Any) -> dict[str, Any]:
    columns = env.sim.cars.T.astype(np.float32, order="C")
    counted = laps.T.astype(np.float32, order="C")
    obs = {"ego_idx": env.ego_idx, "scans": env.sim.agent_scans.astype(np.float32)}
    obs |= {name: columns[column] for name, column in k.ORIGINAL.items()}
    obs |= {"linear_vels_y": np.zeros(env.num_agents, np.float32)}
    return obs | {"lap_times": counted[k.LAP_TIME], "lap_counts": counted[k.LAPS]}


def _features(env: Any, laps: Any, features: tuple[str, ...]) -> dict[str, Any]:
    sim, out = env.sim, {}
    cars, laps = sim.cars.astype(np.float32), laps.astype(np.float32)
    for i, name in enumerate(env.agent_ids):
        x, y, delta, v, theta, rate, beta = cars[i, :7]
        values = {
            "scan": sim.agent_scans[i].astype(np.float32) if "scan" in features else None,
            "pose_x": x,
            "pose_y": y,
            "pose_theta": theta,
            "ang_vel_z": rate,
            "delta": delta,
            "beta": beta,
            "linear_vel_x": v * np.cos(beta),
            "linear_vel_y": v * np.sin(beta),
            # The gym omits contacts between cars here.
            "collision": int(cars[i, k.WALL]),
            "lap_time": laps[i, k.LAP_TIME],
            "lap_count": laps[i, k.LAPS],
        }
        out[name] = {feature: values[feature] for feature in features}
    return out
