"""Circuits: the track value, Frenet coordinates, reading maps, and how a track is built."""
