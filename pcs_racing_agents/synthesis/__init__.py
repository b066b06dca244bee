"""Making archives: a directed search for what nothing beats in everything, be it policies or points of any function."""

from pcs_racing_agents.synthesis.archive_run import News, make_archive
from pcs_racing_agents.synthesis.config import ArchiveConfig, list_archive_configs, load_archive_config
from pcs_racing_agents.synthesis.diverse import select_diverse
from pcs_racing_agents.synthesis.evaluate import Evaluation, Scenarios, draw_scenarios
from pcs_racing_agents.synthesis.indicators import hypervolume
from pcs_racing_agents.synthesis.synthesize import Search, Synthesis, synthesize

__all__ = [
    "ArchiveConfig",
    "Evaluation",
    "News",
    "Scenarios",
    "Search",
    "Synthesis",
    "draw_scenarios",
    "hypervolume",
    "list_archive_configs",
    "load_archive_config",
    "make_archive",
    "select_diverse",
    "synthesize",
]
