"""Why a search misses strong policies, and what searches against the last winner find."""
