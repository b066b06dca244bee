"""PPO and counterfactual regret in equal races, with the best open-loop agent and planner."""
