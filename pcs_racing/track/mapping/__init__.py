"""Offline tools for maps: complete map folders, pictures of circuits, and random circuits.

They need ``pip install "pcs-racing[mapping]"``, and for pictures ``pip install "pcs-racing[plots]"``.
"""
