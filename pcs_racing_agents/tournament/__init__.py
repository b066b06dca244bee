"""Tournaments: games between competitors, pairings, statistics, ratings and result tables."""

from pcs_racing_agents.base.executors import make_executor
from pcs_racing_agents.base.jobs import open_job, show_progress
from pcs_racing_agents.base.statistics import compare, holm
from pcs_racing_agents.tournament.fitting import (
    TrainingRaces,
    fit_best_fixed,
    fit_best_lead_plan,
    fit_best_schedule,
)
from pcs_racing_agents.tournament.pairings import (
    Pairing,
    cross_pairing,
    draw_schedule,
    play_pairing,
    play_pairings,
    repeat_race,
    schedule_pairing,
)
from pcs_racing_agents.tournament.plan import (
    TournamentPlan,
    plan_tournament,
    tournament_settings,
)
from pcs_racing_agents.tournament.protocol import (
    Protocol,
    ProtocolConfig,
    load_protocol,
    play_protocol,
    protocol_text,
)
from pcs_racing_agents.tournament.race_files import read_results, write_results
from pcs_racing_agents.tournament.races import (
    RaceRow,
    RaceTable,
    closeness_text,
    concatenate_races,
)
from pcs_racing_agents.tournament.ratings import (
    RoundRobin,
    excess,
    max_entropy_equilibrium,
    rate,
    round_robin,
)
from pcs_racing_agents.tournament.result import Standing, Tournament, play_plan, play_tournament

__all__ = [
    "Pairing",
    "Protocol",
    "ProtocolConfig",
    "RaceRow",
    "RaceTable",
    "RoundRobin",
    "Standing",
    "Tournament",
    "TournamentPlan",
    "TrainingRaces",
    "closeness_text",
    "compare",
    "concatenate_races",
    "cross_pairing",
    "draw_schedule",
    "excess",
    "fit_best_fixed",
    "fit_best_lead_plan",
    "fit_best_schedule",
    "holm",
    "load_protocol",
    "make_executor",
    "max_entropy_equilibrium",
    "open_job",
    "plan_tournament",
    "play_pairing",
    "play_pairings",
    "play_plan",
    "play_protocol",
    "play_tournament",
    "protocol_text",
    "rate",
    "read_results",
    "repeat_race",
    "round_robin",
    "schedule_pairing",
    "show_progress",
    "tournament_settings",
    "write_results",
]
