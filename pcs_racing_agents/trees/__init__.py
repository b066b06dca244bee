"""Game trees of races: the data of solvers and networks, simulated once and stored in files."""

from pcs_racing_agents.trees.build import build_tree
from pcs_racing_agents.trees.ego import EgoTrees, play_ego
from pcs_racing_agents.trees.roots import choose_pairs
from pcs_racing_agents.trees.storage import StoredTrees, build_ego_trees, build_trees, load_ego_trees, load_trees
from pcs_racing_agents.trees.tree import RaceTree, TreeStatistics

__all__ = [
    "EgoTrees",
    "RaceTree",
    "StoredTrees",
    "TreeStatistics",
    "build_ego_trees",
    "build_tree",
    "build_trees",
    "choose_pairs",
    "load_ego_trees",
    "load_trees",
    "play_ego",
]
