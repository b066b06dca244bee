"""Learned characteristics: axes that tell a policy's rating and its place in the cycle from a segment of a race."""
