"""Statistics of paired races: scores, comparisons and means that know of clusters, p-values of a whole table."""

from pcs_racing_agents.tournament.statistics.clusters import Estimate, clustered_mean
from pcs_racing_agents.tournament.statistics.comparison import Comparison, compare, holm
from pcs_racing_agents.tournament.statistics.units import match_units, score

__all__ = ["Comparison", "Estimate", "clustered_mean", "compare", "holm", "match_units", "score"]
