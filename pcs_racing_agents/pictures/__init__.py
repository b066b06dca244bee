"""The style of all pictures."""
