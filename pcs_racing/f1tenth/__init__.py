"""The F1TENTH gym's environments, for programs that were written for them: see docs/coming_from_f1tenth_gym.md.

``python -m pcs_racing.f1tenth PROGRAM.py ARGS`` runs such a program without an edit. With one line changed it uses
``gymnasium.make("pcs_racing:f110-v0", map=...)`` (generation A, 0.2.1) or ``gymnasium.make("pcs_racing:f1tenth-v0",
config=...)`` (generation B, v1.0.0); classes have their old names in this module.
"""

from importlib import import_module
from typing import Any

import gymnasium

IDS = {
    "f110-v0": "pcs_racing.f1tenth.generation_a:GenerationA",
    "f1tenth-v0": "pcs_racing.f1tenth.generation_b:GenerationB",
}
"""Where the environment is, by its name in Gymnasium."""

_WHERE = {
    "F110Env": "env",
    "GenerationA": "generation_a",
    "GenerationB": "generation_b",
    "Integrator": "generation_a",
    "Simulator": "simulator",
    "RaceCar": "simulator",
    "Track": "lines",
    "TrackSpec": "lines",
    "Raceline": "lines",
    "CubicSpline2D": "lines",
    "nearest_point_on_trajectory": "lines",
    "EnvRenderer": "rendering",
    "RenderSpec": "rendering",
    "DynamicModel": "old_names",
    "IntegratorType": "old_names",
    "LongitudinalActionEnum": "old_names",
    "SteerActionEnum": "old_names",
    "deep_update": "generation_b",
    "get_vertices": "old_names",
}


def register_environments() -> None:
    """Make both environments known to ``gymnasium.make``; names that are known already are left as they are.

    No wrapper: programs reach for attributes of the environment, and generation A returns four values.
    """
    for name, entry in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(name, entry_point=entry, disable_env_checker=True, order_enforce=False)


def __getattr__(name: str) -> Any:
    """Import a class when it is asked for."""
    if name in _WHERE:
        return getattr(import_module(f"pcs_racing.f1tenth.{_WHERE[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
