"""Learning: PPO, responses learned from branched games, and learned characteristics."""
