"""The game of choosing a policy before the start: payoffs of all pairs of a pool, and their analysis."""
