from . import (
    agents as agents,
    learning as learning,
    networks as networks,
    policies as policies,
    solvers as solvers,
    study as study,
    tournament as tournament,
    trees as trees,
    watch as watch,
)
from .agents.agent import Agent as Agent
from .agents.zoo import make as make
from .networks.from_trees import train_regrets as train_regrets
from .networks.network_files import load_network as load_network
from .policies.archive_run import synthesize as synthesize
from .solvers.compare import solve as solve
from .tournament.ratings import rate as rate
from .tournament.result import play_tournament as play_tournament
from .trees.build import build_tree as build_tree

__all__ = [
    "Agent",
    "agents",
    "build_tree",
    "learning",
    "load_network",
    "make",
    "networks",
    "play_tournament",
    "policies",
    "rate",
    "solve",
    "solvers",
    "study",
    "synthesize",
    "tournament",
    "train_regrets",
    "trees",
    "watch",
]
