"""Environments for reinforcement learning: strategy level, single agent, and control level."""
