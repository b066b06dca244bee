"""Fixed policies of the zoo, from outside the archive, in one or several variants."""

from pathlib import Path

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.planners.registry import get_planner
from pcs_racing.planners.trained import NAME, load_trained, read_trained
from pcs_racing_agents.agents.agent import Driver
from pcs_racing_agents.agents.game_spec import GameSpec, training_text
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


def trained_driver(
    spec: GameSpec, *, name: str = "ppo-drive", seed: int = 0, network: str | Path | None = None
) -> Driver:
    """Return a network for steering and speed as a fixed policy.

    ``pcs-racing ppo`` trains such networks at the control level. They need no archive.

    Parameters
    ----------
    network : str or Path, optional
        Another network: the name of a shipped one or its folder.
    """
    planner = get_planner(NAME) if network is None else load_trained(network)
    _, manifest = read_trained(NAME if network is None else network)
    facts = {
        "network": manifest["name"],
        "trained on": training_text(manifest["training"]),
        "weights sha256": manifest["weights_sha256"],
    }
    return Driver(name, (planner.policy(name=name),), facts)


RANDOM_POLICY = Entry(
    random_policy,
    "keeps one of all policies that synthesis evaluated, in the archive or not",
    "the paper's random agent",
    moves=False,
)
LANE_SWITCHER = Entry(
    lane_switcher,
    "race line or overtaking lane; 20 variants. In the paper's race `response`, and with it"
    " `adaptive`, learned against all of them; in either race `ppo` learned against four (1, 6,"
    " 11, 16)",
    "after the winner of the F1TENTH race at ICRA 2022, which is the unseen opponent in the paper",
    moves=False,
)
PPO_DRIVE = Entry(
    trained_driver,
    "a network trained by PPO in races sets steering and speed 25 times a second",
    "Schulman et al. 2017, with Stable-Baselines3",
    moves=False,
)
