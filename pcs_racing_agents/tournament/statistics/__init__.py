"""Statistics of paired races: comparisons that know of clusters, resampling, rates, power and the adaptivity gain."""

from pcs_racing_agents.tournament.statistics.adaptivity import AdaptivityGain, adaptivity_gain
from pcs_racing_agents.tournament.statistics.clusters import Estimate, clustered_mean
from pcs_racing_agents.tournament.statistics.comparison import Comparison, PairedT, compare, paired_t
from pcs_racing_agents.tournament.statistics.power import (
    VarianceComponents,
    detectable_effect,
    power,
    variance_components,
)
from pcs_racing_agents.tournament.statistics.rates import EffectSizes, effect_sizes, holm, wilson
from pcs_racing_agents.tournament.statistics.resampling import bootstrap_interval, sign_flip_p
from pcs_racing_agents.tournament.statistics.units import match_units, score

__all__ = [
    "AdaptivityGain",
    "Comparison",
    "EffectSizes",
    "Estimate",
    "PairedT",
    "VarianceComponents",
    "adaptivity_gain",
    "bootstrap_interval",
    "clustered_mean",
    "compare",
    "detectable_effect",
    "effect_sizes",
    "holm",
    "match_units",
    "paired_t",
    "power",
    "score",
    "sign_flip_p",
    "variance_components",
    "wilson",
]
