"""The game on top of the race: characteristics, archives of policies, moves in Policy
Characteristic Space.
"""
