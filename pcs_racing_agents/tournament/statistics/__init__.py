"""Statistics of paired races: scores, cluster-robust means and comparisons, adjusted p-values."""

from pcs_racing_agents.tournament.statistics.clusters import Estimate, clustered_mean, match_units, score
from pcs_racing_agents.tournament.statistics.comparison import Comparison, compare, holm

__all__ = ["Comparison", "Estimate", "clustered_mean", "compare", "holm", "match_units", "score"]
