"""Offline map tools: completion of map folders, and random circuits.

They need ``pip install "pcs-racing[mapping]"``.
"""
