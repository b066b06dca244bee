"""PPO baselines at the strategy level and at the control level, trained with Stable-Baselines3."""
