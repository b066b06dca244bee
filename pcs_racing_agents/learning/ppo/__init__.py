"""PPO baselines that move between policies, trained with Stable-Baselines3."""
