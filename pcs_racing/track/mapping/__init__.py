"""Offline tools: from a grid to a centre line, from there to a race line and its speeds, and random circuits.

``speed`` needs nothing beyond the base installation; the other modules need ``pip install "pcs-racing[mapping]"``.
"""
