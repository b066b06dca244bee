"""The long report of headroom: within a slot of the grid, over lead plans, cycles and equilibria."""
