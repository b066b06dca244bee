"""The game of choosing a policy before the start: payoffs of all pairs of a pool, and their analysis."""

from pcs_racing_agents.payoffs.choosing import choose_pool, denoised, pool_headroom
from pcs_racing_agents.payoffs.headroom import (
    CyclicPlane,
    Headroom,
    cyclic_part,
    cyclic_planes,
    headroom,
    ratings,
    transitive_share,
)
from pcs_racing_agents.payoffs.policy_pool import PolicyPool, pool_payoffs, slot_payoffs, spanning_policies
