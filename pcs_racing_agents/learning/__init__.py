"""Learning: PPO, and answers learned from branched games."""
