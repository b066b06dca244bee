"""PPO baselines, trained with Stable-Baselines3 from committed settings, at the levels of strategy and of control."""
