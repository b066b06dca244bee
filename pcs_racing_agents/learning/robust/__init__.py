"""Robust answers: restricted Nash responses and policy-space response oracles, made of learned responses."""

from pcs_racing_agents.learning.robust.oracles import learn_psro
from pcs_racing_agents.learning.robust.restricted import learn_robust
from pcs_racing_agents.learning.robust.settings import (
    PSROSettings,
    RobustSettings,
    load_psro_settings,
    load_robust_settings,
)

__all__ = [
    "PSROSettings",
    "RobustSettings",
    "learn_psro",
    "learn_robust",
    "load_psro_settings",
    "load_robust_settings",
]
