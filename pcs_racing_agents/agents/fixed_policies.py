"""Fixed policies of the zoo, from outside the archive."""

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.planners.planner import PolicySet
from pcs_racing_agents.agents.game_spec import GameSpec
from pcs_racing_agents.agents.zoo import Entry


def random_policy(
    spec: GameSpec, *, name: str = "random-policy", seed: int = 0, first: int | None = None
) -> PolicySet:
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
    return PolicySet(name, tuple(archive.explored_policy(i) for i in range(count)))


RANDOM_POLICY = Entry(
    random_policy,
    "keeps one of all policies that synthesis evaluated, in the archive or not",
    "the paper's random agent",
    moves=False,
)
