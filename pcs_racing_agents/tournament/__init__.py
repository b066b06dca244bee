"""Tournaments: games between competitors, pairings, statistics, ratings and result tables."""

from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.tournament.pairings import (
    Pairing,
    cross_pairing,
    draw_schedule,
    schedule_pairing,
)
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
from pcs_racing_agents.tournament.race_files import read_results, write_results
from pcs_racing_agents.tournament.races import (
    RaceRow,
    RaceTable,
    closeness_text,
    concatenate_races,
)
from pcs_racing_agents.tournament.ratings import RoundRobin, rate, round_robin
from pcs_racing_agents.tournament.runner import play_pairing, play_pairings, repeat_race
from pcs_racing_agents.tournament.table import standings, tournament_text
