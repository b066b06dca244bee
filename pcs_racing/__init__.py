"""Head-to-head autonomous racing in Policy Characteristic Space."""
