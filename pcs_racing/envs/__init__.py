"""Environments for reinforcement learning: strategy level, single agent, and control level.

Importing :mod:`pcs_racing` registers them with Gymnasium and PettingZoo; the code behind a name is imported when an
environment is made.
"""
