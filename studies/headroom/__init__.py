"""The long report of headroom: within a slot of the grid, lead plans, cycles and equilibria."""
