"""What robustness costs: gain against a pool over loss to a best reply, for several robust responses."""
