"""Names of the agents of this package, apart from their code, which takes a second to import."""

SHIPPED = {
    "never-switch": "pcs_racing_agents.agents.blind:NEVER_SWITCH",
    "random-moves": "pcs_racing_agents.agents.blind:RANDOM_MOVES",
    "best-schedule": "pcs_racing_agents.agents.blind:BEST_SCHEDULE",
    "best-fixed": "pcs_racing_agents.agents.blind:BEST_FIXED",
    "best-lead-plan": "pcs_racing_agents.agents.blind:BEST_LEAD_PLAN",
    "cfr-argmax": "pcs_racing_agents.agents.from_network:CFR_ARGMAX",
    "cfr-regret-matching": "pcs_racing_agents.agents.from_network:CFR_REGRET_MATCHING",
    "nash": "pcs_racing_agents.agents.from_network:NASH",
    "response": "pcs_racing_agents.agents.from_network:RESPONSE",
    "psro": "pcs_racing_agents.agents.mixture:PSRO",
    "self-play": "pcs_racing_agents.agents.mixture:SELF_PLAY",
    "ppo": "pcs_racing_agents.agents.from_network:PPO",
    "random-policy": "pcs_racing_agents.agents.blind:RANDOM_POLICY",
}
"""Agents and fixed policies of this package: name, and reference to the entry.

A new agent is a file and a line here. In addition, ``always-MOVE`` exists for every move.
"""
