"""Self-play: counterfactual regret minimisation in which both cars learn, on branched games."""

from pcs_racing_agents.learning.self_play.learner import (
    Arena,
    SelfPlaySettings,
    learn_self_play,
    load_self_play_settings,
)
from pcs_racing_agents.learning.self_play.race_arena import RaceArena

__all__ = ["Arena", "RaceArena", "SelfPlaySettings", "learn_self_play", "load_self_play_settings"]
