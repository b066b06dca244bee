"""Game trees of races: the data of solvers and networks, simulated once and stored in files."""

from pcs_racing_agents.trees.build import build_tree, choose_pairs
from pcs_racing_agents.trees.storage import StoredTrees, build_trees, load_trees
from pcs_racing_agents.trees.tree import RaceTree, TreeStatistics

__all__ = [
    "RaceTree",
    "StoredTrees",
    "TreeStatistics",
    "build_tree",
    "build_trees",
    "choose_pairs",
    "load_trees",
]
