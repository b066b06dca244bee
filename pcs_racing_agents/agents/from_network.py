"""Agents that decide by a network's values of the moves: the paper's agent and its variants.

Decision rules turn values into probabilities; both have shape (B, M).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import UnknownNameError
from pcs_racing.base.typing import Floats
from pcs_racing.game.identity import check_same_game
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.observing import ObservationBatch
from pcs_racing_agents.agents.training import shipped_name, training_text
from pcs_racing_agents.agents.zoo import Entry
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.network_files import list_networks, load_network


def argmax(values: NDArray[Any]) -> Floats:
    """Return probability 1 for the move with the max value; the first move wins ties.

    With unclipped regrets, this is the paper's rule (the argmax of the clipped regret) if a regret
    is positive. If no regret is positive, the paper allows any move; this rule takes the move with
    the max (least negative) regret.
    """
    probabilities = np.zeros(values.shape)
    np.put_along_axis(probabilities, np.argmax(values, axis=-1)[..., None], 1.0, axis=-1)
    return probabilities


def regret_matching(values: NDArray[Any]) -> Floats:
    """Return probabilities proportional to positive regret (Hart and Mas-Colell 2000).

    If no regret is positive, the rule is argmax. Outputs that are already probabilities do not
    change.
    """
    positive = np.maximum(np.asarray(values, np.float64), 0.0)
    total = positive.sum(axis=-1, keepdims=True)
    return np.where(total > 0.0, positive / np.where(total > 0.0, total, 1.0), argmax(values))


def softmax(values: NDArray[Any]) -> Floats:
    """Return probabilities proportional to the exponential of the values, which are logits."""
    exponentials = np.asarray(values, np.float64)
    exponentials = np.exp(exponentials - exponentials.max(axis=-1, keepdims=True))
    return exponentials / exponentials.sum(axis=-1, keepdims=True)


DECISIONS: dict[str, Callable[[NDArray[Any]], Floats]] = {
    "argmax": argmax,
    "regret-matching": regret_matching,
    "sample": regret_matching,
    "softmax": softmax,
}
"""Decision rules by name."""


def get_decision(name: str) -> Callable[[NDArray[Any]], Floats]:
    """Return a decision rule."""
    if name not in DECISIONS:
        raise UnknownNameError(f"decision {name!r} is unknown; there are {', '.join(DECISIONS)}")
    return DECISIONS[name]


NetworkSource = str | RegretNetwork | None
"""A network, its name or folder, or None for the shipped network."""

_DETAILS = ("setting_", "test_", "validation_", "training_")


@dataclass(frozen=True, eq=False)
class NetworkStrategy:
    """A strategy that applies a decision rule to the values of a network."""

    network: RegretNetwork  #: Network; without a value for "stay", the last move, it never stays.
    decision: str  #: Key in :data:`pcs_racing_agents.agents.from_network.DECISIONS`.
    count: int  #: Number M of all moves.

    def __post_init__(self) -> None:
        get_decision(self.decision)

    def __call__(self, observation: ObservationBatch) -> Floats:
        """Return the probabilities of the moves, shape (B, M)."""
        values = self.network.unclipped(observation)
        probabilities = np.zeros((len(observation), self.count))
        probabilities[:, : values.shape[1]] = get_decision(self.decision)(values)
        return probabilities


def network_agent(
    network: RegretNetwork, spec: RaceGame, seed: int = 0, decision: str = "argmax"
) -> Agent:
    """Return the agent of a network, with the network's name."""
    return Agent(network.name, NetworkStrategy(network, decision, len(spec.moves)), spec, seed)


def fitting_network(source: NetworkSource, spec: RaceGame, kind: str, agent: str) -> RegretNetwork:
    """Return a network for a game spec, after a check that it belongs to this game.

    Parameters
    ----------
    source : RegretNetwork, str or path, optional
        The network, the name of a shipped network, or a folder; by default the shipped network
        ``ARCHIVE-RULES-KIND``.
    kind : str
        Quantity that the network was trained to approximate.
    agent : str
        Name of the agent, for error messages.
    """
    if source is None:
        how = "train a network with 'pcs-racing train' and give it as network=FOLDER"
        source = shipped_name(spec, kind, list_networks(), f"agent {agent!r}", how)
    network = load_network(source)
    check_same_game(network.identity, spec.identity, f"agent {agent!r}: network {network.name!r}")
    return network


def network_facts(network: RegretNetwork) -> dict[str, str]:
    """Return facts about an agent's network for reports."""
    # The manifest has all fields; these fields describe the amount of training data.
    figures = {
        key: value for key, value in network.training.items() if not key.startswith(_DETAILS)
    }
    return {
        "network": f"{network.name}: {network.target}, rules {network.identity.rules}",
        "trained on": training_text(figures),
        "weights sha256": fingerprint(network.layers),
    }


# Agents


def from_network(
    spec: RaceGame,
    *,
    name: str,
    seed: int = 0,
    kind: str,
    decision: str = "argmax",
    network: NetworkSource = None,
) -> Agent:
    """Return an agent that decides by a network's values of the moves.

    Parameters
    ----------
    kind : str
        Quantity that the network was trained to approximate; part of the name of the shipped
        network (``ARCHIVE-RULES-KIND``).
    decision : {"argmax", "regret-matching", "sample", "softmax"}
        The rule: ``argmax``, ``regret-matching``, ``sample`` or ``softmax``.
    network : RegretNetwork, str or path, optional
        Another network: the name of a shipped one or its folder.
    """
    loaded = fitting_network(network, spec, kind, name)
    strategy = NetworkStrategy(loaded, decision, len(spec.moves))
    return Agent(name, strategy, spec, seed, {**network_facts(loaded), "decision": decision})


def _entry(kind: str, decision: str, summary: str, source: str) -> Entry:
    return Entry(from_network, summary, source, "network", {"kind": kind, "decision": decision})


CFR_ARGMAX = _entry(
    "regret",
    "argmax",
    "makes the move with the highest predicted counterfactual regret",
    "the paper's GT agent, Equations 8 and 9",
)
CFR_REGRET_MATCHING = _entry(
    "regret",
    "regret-matching",
    "draws a move with a probability proportional to its positive predicted counterfactual regret",
    "the paper's remark on regret matching (Zinkevich et al. 2007)",
)
NASH = _entry(
    "nash",
    "sample",
    "draws its moves from an approximate equilibrium strategy",
    "backward induction, sampled",
)
RESPONSE = _entry(
    "response",
    "argmax",
    "plays an approximate best response to the pool of opponents that it was trained against",
    "advantages in branched races, learned from the last step backwards"
    " (`pcs_racing_agents.learning.responses`)",
)
PPO = _entry(
    "ppo",
    "argmax",
    "makes the most probable move of a policy trained by PPO",
    "Schulman et al. 2017, with Stable-Baselines3",
)
