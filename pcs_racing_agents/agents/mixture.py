"""Mixtures of agents: a draw of one of several agents for each game.

Meta-strategies and averages of iterations are mixtures. By Kuhn's theorem, draws at each decision
can replace a draw before the game: each member then has the posterior probability of having reached
the situation. So a mixture is an ordinary strategy, a function of the observation, and its
exploitability can be measured like the exploitability of any strategy.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import InputError
from pcs_racing.base.typing import Floats
from pcs_racing.game.identity import check_same_game
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.from_network import network_agent
from pcs_racing_agents.agents.observing import ObservationBatch, earlier, moves_made, own
from pcs_racing_agents.agents.training import shipped_name, training_text
from pcs_racing_agents.agents.zoo import Entry
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.networks.network_files import (
    NetworkSet,
    check_weights,
    list_network_sets,
    load_network_set,
)

NetworkSetSource = str | NetworkSet | None
"""A network set, its name or folder, or None for the shipped set."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """A strategy that draws one of its members for each game."""

    members: tuple[Agent, ...]
    weights: Floats  #: shape (C,): Probabilities of the members; they sum to 1.
    spec: RaceGame  #: Game spec of all members.

    def __call__(self, observation: ObservationBatch) -> Floats:
        """Return the probabilities of the moves, shape (B, M)."""
        steps = moves_made(observation, self._axes)
        probabilities = np.zeros((len(observation), len(self.spec.moves)))
        for step in np.unique(steps):
            rows = np.flatnonzero(steps == step)
            probabilities[rows] = self._at(observation[rows], int(step))
        return probabilities

    @property
    def _axes(self) -> int:
        return len(self.spec.archive.characteristics)

    def _at(self, observation: ObservationBatch, step: int) -> Floats:
        """Return the probabilities of the moves for observations at one step."""
        archive, axes = self.spec.archive, self._axes
        posterior = np.tile(self.weights, (len(observation), 1))
        for k in range(step):
            past = earlier(observation, axes, k)
            policy, next_policy = (archive.nearest(own(observation, axes, at)) for at in (k, k + 1))
            # A move is not observed, only the resulting policy: all moves with this result count,
            # (B, M).
            possible = self.spec.table[policy] == next_policy[:, None]
            for c, member in enumerate(self.members):
                posterior[:, c] *= (member.probabilities(past) * possible).sum(axis=1)
        total = posterior.sum(axis=1, keepdims=True)
        # If no member can reach a situation, the weights apply, as if the game began here.
        posterior = np.where(
            total > 0.0, posterior / np.where(total > 0.0, total, 1.0), self.weights
        )
        probabilities = np.stack(
            [member.probabilities(observation) for member in self.members], axis=1
        )
        return (posterior[:, :, None] * probabilities).sum(axis=1)


def make_mixture(members: Sequence[Agent], weights: ArrayLike) -> Mixture:
    """Return a mixture of agents of one game spec; members of weight 0 are left out."""
    shares = check_weights("weights", weights, len(members))
    for member in members:
        if not isinstance(member, Agent):
            raise InputError(f"{member!r} can't be a member of a mixture; only agents can")
        first, own = members[0].spec, member.spec
        if (own.archive.content_hash, own.rules) != (first.archive.content_hash, first.rules):
            raise InputError(
                f"members {members[0].name!r} and {member.name!r} are made for different archives"
                " or rules; a mixture needs one"
            )
    positive = np.flatnonzero(shares > 0.0)
    return Mixture(
        tuple(members[int(i)] for i in positive), shares[positive] / shares.sum(), members[0].spec
    )


# Agents


def from_network_set(
    spec: RaceGame, *, name: str, seed: int = 0, kind: str, networks: NetworkSetSource = None
) -> Agent:
    """Return an agent that draws one of several networks for each game.

    The agent decides by the values of the moves from the drawn network.

    Parameters
    ----------
    kind : str
        Method that made the networks; part of the name of the shipped set (``ARCHIVE-RULES-KIND``).
    networks : NetworkSet, str or path, optional
        Another set: the name of a shipped one or its folder.
    """
    if networks is None:
        how = f"make networks with 'pcs-racing train {kind}' and give them as networks=FOLDER"
        networks = shipped_name(spec, kind, list_network_sets(), f"agent {name!r}", how)
    loaded = load_network_set(networks)
    check_same_game(loaded.identity, spec.identity, f"agent {name!r}: network set {loaded.name!r}")
    members = [network_agent(network, spec, seed, loaded.decision) for network in loaded.networks]
    facts = {
        "networks": f"{loaded.name}: {len(loaded.networks)}, rules {loaded.identity.rules}",
        "weights": ", ".join(f"{weight:.3g}" for weight in loaded.weights),
        "decision": loaded.decision,
        "trained on": training_text(loaded.training),
        "weights sha256": fingerprint(
            [network.layers for network in loaded.networks], loaded.weights
        ),
    }
    return Agent(name, make_mixture(members, loaded.weights), spec, seed, facts)


def _entry(kind: str, summary: str, source: str) -> Entry:
    return Entry(from_network_set, summary, source, "networks", {"kind": kind})


PSRO = _entry(
    "psro",
    "draws a learned response for each game, with the probabilities of an equilibrium between such"
    " responses",
    "policy-space response oracles (Lanctot et al. 2017)",
)
SELF_PLAY = _entry(
    "self-play",
    "plays the average strategy of counterfactual regret minimisation in self-play",
    "single deep CFR (Steinberger 2019) on branched games",
)
