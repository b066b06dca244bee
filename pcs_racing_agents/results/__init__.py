"""Results of races as tables."""
