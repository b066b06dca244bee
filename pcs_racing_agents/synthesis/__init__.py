"""Making archives: from policies at random to a set of which none beats another in everything."""

from pcs_racing_agents.synthesis.random_search import Evaluation, evaluate, front_layers, random_archive

__all__ = ["Evaluation", "evaluate", "front_layers", "random_archive"]
