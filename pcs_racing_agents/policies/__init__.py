"""Search for Pareto sets, of any function and of policies, and the making of archives."""

from pcs_racing_agents.policies.archive_run import make_archive
from pcs_racing_agents.policies.archive_search import ArchiveProgress
from pcs_racing_agents.policies.config import ArchiveConfig, list_archive_configs, load_archive_config
from pcs_racing_agents.policies.diverse import select_diverse
from pcs_racing_agents.policies.evaluate import Evaluation, Scenarios, draw_scenarios
from pcs_racing_agents.policies.indicators import hypervolume
from pcs_racing_agents.policies.search import Search, Synthesis
from pcs_racing_agents.policies.synthesize import synthesize

__all__ = [
    "ArchiveConfig",
    "ArchiveProgress",
    "Evaluation",
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
