"""Mixtures of agents: one of several agents is drawn for each game, as in a meta-strategy or a restricted response.

By Kuhn's theorem a draw before the game can be replaced by draws at each decision, in which every member has the
posterior probability of having reached the situation. So a mixture is an ordinary strategy, a function of the
observation, whose exploitability can be measured like that of any other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_number
from pcs_racing.base.errors import InputError
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.fits import FitSource, find_fit, fit_facts
from pcs_racing_agents.agents.observing import ObservationBatch, earlier, moves_made, own
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.agents.zoo import Entry, build_member

__all__ = ["Mixture", "make_mixture", "psro", "restricted_response"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Mixture:
    """A strategy that draws one of its members for each game.

    Attributes
    ----------
    members : tuple of Agent
    weights : ndarray, shape (C,)
        Probabilities of the members; they sum to 1.
    setting : Setting
        Common to all members.
    """

    members: tuple[Agent, ...]
    weights: Floats
    setting: Setting

    def __call__(self, observation: ObservationBatch) -> Floats:
        """Probabilities of the moves, shape (B, M)."""
        steps = moves_made(observation, self._axes)
        probabilities = np.zeros((len(observation), len(self.setting.moves)))
        for step in np.unique(steps):
            rows = np.flatnonzero(steps == step)
            probabilities[rows] = self._at(observation[rows], int(step))
        return probabilities

    @property
    def _axes(self) -> int:
        return len(self.setting.archive.characteristics)

    def _at(self, observation: ObservationBatch, step: int) -> Floats:
        """Probabilities of the moves for observations at one step."""
        archive, axes = self.setting.archive, self._axes
        posterior = np.tile(self.weights, (len(observation), 1))
        for k in range(step):
            past = earlier(observation, axes, k)
            policy, next_policy = (archive.nearest(own(observation, axes, at)) for at in (k, k + 1))
            # A move is not observed, only the policy that it leads to: all moves with the same result count, (B, M).
            possible = self.setting.table[policy] == next_policy[:, None]
            for c, member in enumerate(self.members):
                posterior[:, c] *= (member.probabilities(past) * possible).sum(axis=1)
        total = posterior.sum(axis=1, keepdims=True)
        # A situation that no member can reach: as if the game began here.
        posterior = np.where(total > 0.0, posterior / np.where(total > 0.0, total, 1.0), self.weights)
        probabilities = np.stack([member.probabilities(observation) for member in self.members], axis=1)
        return (posterior[:, :, None] * probabilities).sum(axis=1)


def make_mixture(members: Sequence[Agent], weights: ArrayLike) -> Mixture:
    """Return a mixture of agents of one setting; members of weight 0 are left out.

    Raises
    ------
    InputError
        If there is no member, the weights do not fit, or the members are made for different games.
    """
    shares = np.asarray(weights, np.float64)
    if len(members) == 0 or shares.shape != (len(members),):
        raise InputError(
            f"there are {len(members)} members and weights of shape {shares.shape}; give one weight for each"
        )
    if not np.isfinite(shares).all() or (shares < 0.0).any() or not shares.any():
        raise InputError(f"weights are {shares.tolist()}; they must be finite, 0 or above, and not all 0")
    for member in members:
        if not isinstance(member, Agent):
            raise InputError(f"{member!r} can't be a member of a mixture; only agents can")
        first = members[0].setting
        if (member.setting.archive.content_hash, member.setting.config) != (first.archive.content_hash, first.config):
            raise InputError(
                f"members {members[0].name!r} and {member.name!r} are made for different archives or rules; a mixture "
                "needs one"
            )
    positive = np.flatnonzero(shares > 0.0)
    return Mixture(tuple(members[int(i)] for i in positive), shares[positive] / shares.sum(), members[0].setting)


# Agents


def restricted_response(
    setting: Setting,
    *,
    name: str = "restricted-response",
    seed: int = 0,
    exploit: str | Agent = "static-q",
    safe: str | Agent = "nash",
    share: float = 0.5,
) -> Agent:
    """Draw for each game which of two agents plays it: one that exploits, or one that plays safe.

    Parameters
    ----------
    setting : Setting
    name : str
    seed : int
    exploit : Agent or str
        The agent that exploits.
    safe : Agent or str
        The agent of the other games.
    share : float
        The probability of exploiting, in [0, 1].
    """
    check_number(f"the share of agent {name!r}", share, 0.0, 1.0)
    members = [build_member(member, setting, seed) for member in (exploit, safe)]
    facts = {"mixture": f"{share:g} {members[0].name}, {1.0 - share:g} {members[1].name}"}
    return Agent(name, make_mixture(members, [share, 1.0 - share]), setting, seed, facts)


def psro(
    setting: Setting,
    *,
    name: str = "psro",
    seed: int = 0,
    weights: Mapping[str, float] | None = None,
    members: Sequence[Agent] = (),
    fit: FitSource = None,
) -> Agent:
    """Draw an agent for each game, with the probabilities of an equilibrium of the game of choosing agents.

    Parameters
    ----------
    setting : Setting
    name : str
    seed : int
    weights : mapping of str to float, optional
        The probability of each agent, by name.
    members : sequence of Agent
        Agents given as objects instead of by name.
    fit : Fit or path, optional
        Weights computed by :func:`pcs_racing_agents.tournament.fitting.fit_psro`; the shipped ones by default.
    """
    facts: dict[str, str] = {}
    if weights is None:
        loaded = find_fit("psro", setting, fit)
        weights, facts = loaded.choice, fit_facts(loaded)
    elif fit is not None:
        raise InputError(f"agent {name!r} got weights and a fit; give one of the two")
    own = {member.name: member for member in members}
    drawn = {key: value for key, value in weights.items() if value}
    agents = [own[key] if key in own else build_member(key, setting, seed) for key in drawn]
    mixture = make_mixture(agents, list(drawn.values()))
    return Agent(name, mixture, setting, seed, {**facts, "mixture": _listed(mixture)})


def _listed(mixture: Mixture) -> str:
    pairs = zip(mixture.weights, mixture.members, strict=True)
    return ", ".join(f"{weight:.3g} {member.name}" for weight, member in pairs)


RESTRICTED_RESPONSE = Entry(
    restricted_response,
    "draws for each game whether to exploit a static opponent or to play an equilibrium",
    "after restricted Nash response (Johanson et al. 2007)",
    "agents",
)
PSRO = Entry(
    psro,
    "draws an agent for each game, with the probabilities of an equilibrium of the game of choosing agents",
    "meta-strategy of PSRO (Lanctot et al. 2017)",
    "fit",
)
