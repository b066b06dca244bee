"""What it is worth to remember the opponent of a match, for a player that learned from races of
known policies.
"""
