"""Offline tools for maps: complete map folders, and random circuits.

They need ``pip install "pcs-racing[mapping]"``.
"""
