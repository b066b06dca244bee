"""Explanations of races: an agent's observations, values and moves as text and pictures, and counts over races."""
