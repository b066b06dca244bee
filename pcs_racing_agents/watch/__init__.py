"""The race viewer: one page with a list and a player of a tournament's races."""
