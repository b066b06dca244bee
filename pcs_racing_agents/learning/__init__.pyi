from .ppo.settings import DriveSettings as DriveSettings
from .ppo.settings import DuelSettings as DuelSettings
from .ppo.train import train_ppo as train_ppo
from .responses import best_reply as best_reply
from .responses import load_response_settings as load_response_settings

__all__ = [
    "DriveSettings",
    "DuelSettings",
    "best_reply",
    "load_response_settings",
    "train_ppo",
]
