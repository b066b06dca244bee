from .best_replies import best_reply as best_reply
from .league import (
    League as League,
    league_callback as league_callback,
    load_league as load_league,
    make_league as make_league,
    save_league as save_league,
)
from .ppo import (
    PPOSettings as PPOSettings,
    load_ppo_settings as load_ppo_settings,
    train_ppo as train_ppo,
)
from .responses import (
    learn_psro as learn_psro,
    learn_response as learn_response,
    load_psro_settings as load_psro_settings,
    load_response_settings as load_response_settings,
)
from .self_play import (
    learn_self_play as learn_self_play,
    load_self_play_settings as load_self_play_settings,
)

__all__ = [
    "League",
    "PPOSettings",
    "best_reply",
    "league_callback",
    "learn_psro",
    "learn_response",
    "learn_self_play",
    "load_league",
    "load_ppo_settings",
    "load_psro_settings",
    "load_response_settings",
    "load_self_play_settings",
    "make_league",
    "save_league",
    "train_ppo",
]
