"""Planners at their defaults, planners tuned with one small budget, and agents, in equal races."""
