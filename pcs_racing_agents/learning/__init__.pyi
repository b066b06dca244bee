from .league import League as League
from .league import load_league as load_league
from .league import make_league as make_league
from .league import save_league as save_league
from .league_callback import LeagueCallback as LeagueCallback
from .ppo.settings import DuelSettings as DuelSettings
from .ppo.train import train_ppo as train_ppo
from .responses import best_reply as best_reply
from .responses import load_response_settings as load_response_settings

__all__ = [
    "DuelSettings",
    "League",
    "LeagueCallback",
    "best_reply",
    "load_league",
    "load_response_settings",
    "make_league",
    "save_league",
    "train_ppo",
]
