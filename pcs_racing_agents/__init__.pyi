from . import agents as agents
from . import learning as learning
from . import networks as networks
from . import policies as policies
from . import solvers as solvers
from . import study as study
from . import tournament as tournament
from . import trees as trees
from . import watch as watch
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
    "agents",
    "build_tree",
    "explain_race",
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
    "train_ppo",
    "train_regrets",
    "trees",
    "watch",
]
