"""Ids of the environments, and their registration with Gymnasium and PettingZoo."""

from typing import Any

import gymnasium
import pettingzoo

PETTINGZOO_IDS = {
    "pcs_racing/head_to_head-v1": "pcs_racing.envs.duel",
    "pcs_racing/drive_head_to_head-v0": "pcs_racing.envs.drive",
    "pcs_racing/line_head_to_head-v0": "pcs_racing.envs.line",
}
"""Modules with ``parallel_env`` and ``env``, by id."""

GYMNASIUM_IDS = {
    "pcs_racing/Duel-v1": ("pcs_racing.envs.duel:DuelEnv", "pcs_racing.envs.duel:DuelVectorEnv"),
    "pcs_racing/Drive-v1": (
        "pcs_racing.envs.drive:DriveEnv",
        "pcs_racing.envs.drive:DriveVectorEnv",
    ),
    "pcs_racing/Line-v0": ("pcs_racing.envs.line:LineEnv", "pcs_racing.envs.line:LineVectorEnv"),
    "pcs_racing/Avoidance-v0": (
        "pcs_racing.envs.drive:DriveEnv",
        "pcs_racing.envs.drive:DriveVectorEnv",
    ),
}
"""Entry points of each environment and its vector environment, by id."""

F1TENTH_IDS = {
    "f110-v0": "pcs_racing.f1tenth.env:GenerationA",
    "f1tenth-v0": "pcs_racing.f1tenth.env:GenerationB",
}
"""Entry points of the environments of the F1TENTH gym, by id."""

ARGUMENTS: dict[str, dict[str, Any]] = {
    "pcs_racing/Avoidance-v0": {
        "opponent": None,
        "laps": 3,
        "beams": 108,
        "see_opponent": "never",
        "obstacles": {"count": 6, "moving": 2, "shape": "roboracer"},
    },
}
"""Arguments of environments that are another environment with other defaults, by id."""


def register_environments() -> None:
    """Register the environments with Gymnasium and PettingZoo.

    Afterwards ``gymnasium.make``, ``gymnasium.make_vec`` and ``pettingzoo.make`` find them.
    Registered names are left unchanged, so repeated calls are safe.
    """
    for name, (single, vector) in GYMNASIUM_IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point=single,
                vector_entry_point=vector,
                kwargs=ARGUMENTS.get(name, {}),
            )
    for name, entry in F1TENTH_IDS.items():
        if name not in gymnasium.registry:
            # Without wrappers: programs use attributes of the environment, and generation A returns
            # four values.
            gymnasium.register(
                name, entry_point=entry, disable_env_checker=True, order_enforce=False
            )
    if not hasattr(pettingzoo, "register"):  # releases before 1.27 have no registry
        return
    for name, module in PETTINGZOO_IDS.items():
        if name not in pettingzoo.parallel_registry:
            pettingzoo.register("parallel", name, f"{module}:parallel_env")
        if name not in pettingzoo.aec_registry:
            pettingzoo.register("aec", name, f"{module}:env")
