"""Policies and agents for :mod:`pcs_racing`: motion planners, archives, strategies and tournaments."""
