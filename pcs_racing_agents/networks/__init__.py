"""Regret approximator: training rows, network, training and evaluation."""

from pcs_racing.base.dense import DenseLayers
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.network_files import (
    NetworkSet,
    list_network_sets,
    list_networks,
    load_network,
    load_network_set,
    save_network,
    save_network_set,
)
from pcs_racing_agents.networks.rows import (
    TARGETS,
    Rows,
    best_moves,
    join_rows,
    node_targets,
    solve_for,
    tree_rows,
)
from pcs_racing_agents.networks.training import TrainSettings, load_train_settings, train_network

__all__ = [
    "TARGETS",
    "DenseLayers",
    "NetworkSet",
    "RegretNetwork",
    "Rows",
    "TrainSettings",
    "best_moves",
    "join_rows",
    "list_network_sets",
    "list_networks",
    "load_network",
    "load_network_set",
    "load_train_settings",
    "node_targets",
    "save_network",
    "save_network_set",
    "solve_for",
    "train_network",
    "tree_rows",
]
