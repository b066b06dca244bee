"""Policy archives: search for Pareto sets, of any function and of policies; payoffs of pools."""

from pcs_racing_agents.policies.archive_run import ArchiveProgress, synthesize
from pcs_racing_agents.policies.config import (
    ArchiveConfig,
    list_archive_configs,
    load_archive_config,
)
from pcs_racing_agents.policies.diverse import select_diverse
from pcs_racing_agents.policies.headroom import (
    CyclicPlane,
    Headroom,
    cyclic_part,
    cyclic_planes,
    headroom,
    ratings,
    transitive_share,
)
from pcs_racing_agents.policies.policy_pool import (
    PolicyPool,
    pool_payoffs,
    slot_payoffs,
    spanning_policies,
)
from pcs_racing_agents.policies.search import Search
from pcs_racing_agents.policies.tuning import Tuned, TuningConfig, tune
