"""Fixed policies of the zoo, from outside the archive, in one or several variants."""

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.planners.registry import get_planner
from pcs_racing_agents.agents.agent import Driver
from pcs_racing_agents.agents.game_spec import GameSpec
from pcs_racing_agents.agents.zoo import Entry


def random_policy(
    spec: GameSpec, *, name: str = "random-policy", seed: int = 0, first: int | None = None
) -> Driver:
    """Return all policies that the archive's synthesis evaluated: the paper's random agent.

    Parameters
    ----------
    first : int, optional
        Number of policies, from the first; by default all. The initial sample comes first: its
        policies were drawn, not searched.
    """
    archive = spec.archive
    explored = len(archive.explored_parameters)
    if explored == 0:
        raise InputError(
            f"archive {archive.name!r} holds no explored policies, so there is no {name!r} to race"
        )
    count = explored if first is None else check_whole("first", first, 1, explored)
    return Driver(name, tuple(archive.explored_policy(i) for i in range(count)))


def lane_switcher(spec: GameSpec, *, name: str = "lane-switcher", seed: int = 0) -> Driver:
    """Return all variants of the lane switcher, which needs no archive."""
    family = get_planner("lane-switcher")
    return Driver(
        name, tuple(family.policy(one, name=f"{family.name}:{one}") for one in family.variants)
    )


RANDOM_POLICY = Entry(
    random_policy,
    "keeps one of all policies that synthesis evaluated, in the archive or not",
    "the paper's random agent",
    moves=False,
)
LANE_SWITCHER = Entry(
    lane_switcher,
    "race line or overtaking lane; 20 variants. In the paper's race `response` learned against all"
    " of them, and `ppo` against four (1, 6, 11, 16)",
    "after the winner of the F1TENTH race at ICRA 2022, the paper's held-out opponent",
    moves=False,
)
