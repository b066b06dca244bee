"""Environments of the F1TENTH gym, for existing programs: see docs/coming_from_f1tenth_gym.md.

``python -m pcs_racing.f1tenth PROGRAM.py ARGS`` runs such a program unmodified. With one changed
line it uses ``gymnasium.make("pcs_racing:f110-v0", map=...)`` (generation A, 0.2.1) or
``gymnasium.make("pcs_racing:f1tenth-v0", config=...)`` (generation B, v1.0.0). Classes have their
old names in this module.
"""

from importlib import import_module
from typing import Any

_PLACES = {
    "env": ("F110Env GenerationA GenerationB Integrator deep_update"),
    "simulator": (
        "Simulator RaceCar ScanSimulator2D pid pid_accl pid_steer vehicle_dynamics_ks"
        " vehicle_dynamics_st"
    ),
    "lines": "Track TrackSpec Raceline CubicSpline2D nearest_point_on_trajectory",
    "rendering": "EnvRenderer TrackRenderer get_vertices",
}
NAMES = {name: module for module, names in _PLACES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """Import a class on first use."""
    if name in NAMES:
        return getattr(import_module(f"pcs_racing.f1tenth.{NAMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
