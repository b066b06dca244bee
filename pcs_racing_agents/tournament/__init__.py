"""Competitors against each other: match play, tournaments, the cells of a study, tables and result files."""

from pcs_racing_agents.jobs.jobs import show_progress
from pcs_racing_agents.tournament.matches import Matches, play_games
from pcs_racing_agents.tournament.play import (
    Tournament,
    TournamentPlan,
    game_rules,
    plan_tournament,
    play_plan,
    play_tournament,
    record_row,
    tournament_settings,
)
from pcs_racing_agents.tournament.rows import RaceRow
from pcs_racing_agents.tournament.table import (
    payoff_matrix,
    payoff_picture,
    standings,
    tournament_text,
    write_results,
    write_rows,
)
from pcs_racing_agents.tournament.watching import record_match

__all__ = [
    "Matches",
    "RaceRow",
    "Tournament",
    "TournamentPlan",
    "game_rules",
    "payoff_matrix",
    "payoff_picture",
    "plan_tournament",
    "play_games",
    "play_plan",
    "play_tournament",
    "record_match",
    "record_row",
    "show_progress",
    "standings",
    "tournament_settings",
    "tournament_text",
    "write_results",
    "write_rows",
]
