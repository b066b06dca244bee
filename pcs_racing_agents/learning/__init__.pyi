from .best_replies import best_reply as best_reply
from .candidates import (
    CandidateNetwork as CandidateNetwork,
    CandidatePolicy as CandidatePolicy,
    MaskableCandidatePolicy as MaskableCandidatePolicy,
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
    "CandidateNetwork",
    "CandidatePolicy",
    "MaskableCandidatePolicy",
    "PPOSettings",
    "best_reply",
    "learn_psro",
    "learn_response",
    "learn_self_play",
    "load_ppo_settings",
    "load_psro_settings",
    "load_response_settings",
    "load_self_play_settings",
    "train_ppo",
]
