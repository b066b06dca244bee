"""Learned characteristics: axes that tell a policy's rating and its place in the cycle from a segment of a race."""

from pcs_racing_agents.learning.characteristics.learn import (
    Learning,
    LearnSettings,
    fit_characteristics,
    learn_characteristics,
)

__all__ = ["LearnSettings", "Learning", "fit_characteristics", "learn_characteristics"]
