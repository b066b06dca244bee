"""Planners from the literature and from courses, each implemented after its paper."""
