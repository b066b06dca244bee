"""Races explained: what an agent saw, what it did and why, in pictures and in words, for one race or for thousands."""
