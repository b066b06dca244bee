"""The game of choosing a policy before the start: payoffs of all pairs of a pool, and their analysis."""

from pcs_racing_agents.payoffs.choosing import choose_pool, denoised, pool_headroom
from pcs_racing_agents.payoffs.headroom import (
    CyclicPlane,
    Headroom,
    SlotHeadroom,
    cyclic_part,
    cyclic_planes,
    headroom,
    ratings,
    slot_headroom,
    transitive_share,
)
from pcs_racing_agents.payoffs.lead_plans import LeadPlanValue, lead_plan_payoffs, lead_plan_value, make_lead_plans
from pcs_racing_agents.payoffs.policy_pool import PolicyPool, pool_payoffs, slot_payoffs, spanning_policies

__all__ = [
    "CyclicPlane",
    "Headroom",
    "LeadPlanValue",
    "PolicyPool",
    "SlotHeadroom",
    "choose_pool",
    "cyclic_part",
    "cyclic_planes",
    "denoised",
    "headroom",
    "lead_plan_payoffs",
    "lead_plan_value",
    "make_lead_plans",
    "pool_headroom",
    "pool_payoffs",
    "ratings",
    "slot_headroom",
    "slot_payoffs",
    "spanning_policies",
    "transitive_share",
]
