"""The benchmark: a fixed protocol, score cards of agents, and a leaderboard."""
