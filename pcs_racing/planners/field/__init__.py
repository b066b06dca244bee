"""Planners of the literature and of courses, each after its paper."""
