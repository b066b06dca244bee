"""Agents that ask a network what each move is worth, and decide by a rule: the paper's agent and its relatives."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.decisions import get_decision
from pcs_racing_agents.agents.observing import Observations
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.networks.network import GameIdentity, RegretNetwork
from pcs_racing_agents.networks.network_files import list_networks, load_network

__all__ = ["FromNetwork", "OverBlind", "fitting_network", "network_facts"]

Floats = NDArray[np.float64]

_DETAILS = ("setting_", "test_", "validation_", "training_")


@dataclass(frozen=True, eq=False)
class FromNetwork:
    """Decides by the values of a network alone.

    Attributes
    ----------
    network : RegretNetwork
        It may value fewer moves than there are: it then leaves out "stay", the last, which is never made.
    decision : str
        One of :data:`pcs_racing_agents.agents.decisions.DECISIONS`.
    count : int
        Number of moves M that there are.
    """

    network: RegretNetwork
    decision: str
    count: int

    def __post_init__(self) -> None:
        get_decision(self.decision)

    def __call__(self, observation: Observations) -> Floats:
        """Chances of the moves, shape (B, M)."""
        values = self.network.unclipped(observation)
        chances = np.zeros((len(observation), self.count))
        chances[:, : values.shape[1]] = get_decision(self.decision)(values)
        return chances


@dataclass(frozen=True, eq=False)
class OverBlind:
    """Keeps to a strategy that never looks at the race, unless the network promises clearly more.

    Attributes
    ----------
    network : RegretNetwork
        What each move is worth; in the units of its target.
    blind : Agent
        The strategy to keep to.
    margin : float
        By how much the best move must be worth more than the blind strategy's, 0 or above. A move that the network does
        not value ("stay", where it has not learned it) is worth 0, as in a network of advantages.
    """

    network: RegretNetwork
    blind: Agent
    margin: float

    def __call__(self, observation: Observations) -> Floats:
        """Chances of the moves, shape (B, M)."""
        habit = self.blind.probabilities(observation)
        values = np.zeros(habit.shape)
        known = self.network.unclipped(observation)
        values[:, : known.shape[1]] = known
        best = np.argmax(known, axis=1)
        rows = np.arange(len(observation))
        gain = values[rows, best] - (habit * values).sum(axis=1)
        return np.where((gain > self.margin)[:, None], np.eye(habit.shape[1])[best], habit)


def fitting_network(source: "str | RegretNetwork | None", setting: Setting, kind: str, who: str) -> RegretNetwork:
    """Return a network after checking that it belongs to a setting.

    Parameters
    ----------
    source : RegretNetwork, str or path, optional
        The network, the name of a shipped one or its folder; by default the shipped one called
        ``ARCHIVE-RACE-KIND``.
    setting : Setting
    kind : str
        What it was trained to approximate.
    who : str
        Name of the agent, for the message.

    Raises
    ------
    UnknownNameError
        If there is no such network.
    InputError
        If it sees other observations or belongs to another archive.
    """
    if source is None:
        source = f"{setting.archive.name}-{setting.race}-{kind}"
        if source not in list_networks():
            known = ", ".join(list_networks()) or "none"
            raise UnknownNameError(
                f"agent {who!r} needs a network, and none called {source!r} is shipped (there are: {known}); train one "
                "with 'pcs-racing train' and give it as network=FOLDER"
            )
    network = load_network(source)
    epsilon = setting.config.epsilon
    identity = GameIdentity(
        elements=setting.elements,
        moves=setting.moves,
        epsilon=epsilon if isinstance(epsilon, tuple) else (epsilon,),
        archive=setting.archive.name,
        archive_sha256=setting.archive.content_hash,
        preset=setting.race,
    )
    try:
        network.check_identity(identity, "the game")
    except InputError as error:
        raise InputError(f"agent {who!r}: {error}") from None
    return network


def network_facts(network: RegretNetwork) -> dict[str, str]:
    """What reports say of an agent's network."""
    from pcs_racing_agents.jobs.fingerprint import fingerprint

    # The manifest has all of it; these are the figures that say how much there was to learn from.
    told = {key: value for key, value in network.training.items() if not key.startswith(_DETAILS)}
    trained = ", ".join(f"{key} {value}" for key, value in told.items())
    return {
        "network": f"{network.name}: {network.target}, preset {network.identity.preset}",
        "trained on": trained or "not said",
        "weights sha256": fingerprint(network.weights, network.biases),
    }
