"""Learning: PPO, responses learned from branched games, PSRO and self-play."""
