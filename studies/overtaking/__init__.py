"""The overtaking protocol of End2Race, for planners."""
