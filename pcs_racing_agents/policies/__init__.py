"""Policy archives: search for Pareto sets, of any function and of policies."""

from pcs_racing_agents.policies.archive_run import SearchProgress, synthesize
from pcs_racing_agents.policies.config import FrontConfig, SpreadConfig, load_archive_config
from pcs_racing_agents.policies.diverse import select_diverse
from pcs_racing_agents.policies.picture import archive_picture
from pcs_racing_agents.policies.search import Search
from pcs_racing_agents.policies.tuning import Tuned, TuningConfig, tune
