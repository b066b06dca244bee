"""Policies against each other: the races, the table and the results file."""

from pcs_racing_agents.tournament.play import RaceRow, Tournament, play_tournament, show_progress
from pcs_racing_agents.tournament.table import payoff_matrix, standings, tournament_text, write_results

__all__ = [
    "RaceRow",
    "Tournament",
    "payoff_matrix",
    "play_tournament",
    "show_progress",
    "standings",
    "tournament_text",
    "write_results",
]
