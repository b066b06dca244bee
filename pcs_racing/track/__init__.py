"""Tracks: the Track class, Frenet coordinates, map readers, and track building."""
