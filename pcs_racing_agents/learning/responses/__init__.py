"""Learned responses: networks trained on branched races, with equal noise for every move."""

from pcs_racing_agents.learning.responses.best_reply import (
    BestReply,
    best_reply,
    check_races,
    reply_text,
    write_reply,
)
from pcs_racing_agents.learning.responses.branches import Branches, branch_games
from pcs_racing_agents.learning.responses.kept_networks import merge_networks
from pcs_racing_agents.learning.responses.learner import (
    ResponseSettings,
    learn_response,
    load_response_settings,
)

__all__ = [
    "BestReply",
    "Branches",
    "ResponseSettings",
    "best_reply",
    "branch_games",
    "check_races",
    "learn_response",
    "load_response_settings",
    "merge_networks",
    "reply_text",
    "write_reply",
]
