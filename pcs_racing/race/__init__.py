"""Races of two cars: rules, start, state, kernel, batches, recording, replays."""
