from .agents.agent import Agent as Agent
from .agents.zoo import make as make
from .learning.ppo.train import train_ppo as train_ppo
from .networks.from_trees import train_regrets as train_regrets
from .networks.network_files import load_network as load_network
from .policies.archive_run import synthesize as synthesize
from .solvers.compare import solve as solve
from .tournament.play import play_tournament as play_tournament
from .tournament.ratings import rate as rate
from .trees.build import build_tree as build_tree
from .watch.explain import explain_race as explain_race

__all__ = [
    "Agent",
    "build_tree",
    "explain_race",
    "load_network",
    "make",
    "play_tournament",
    "rate",
    "solve",
    "synthesize",
    "train_ppo",
    "train_regrets",
]
