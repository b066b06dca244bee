"""Agents, which switch between the policies of an archive, and the hash of a competitor.

An :class:`Agent` is a value: a seed and a function from observations to the probabilities of the
moves. Any other object with ``act`` (:class:`pcs_racing.game.players.SupportsAct`) can replace it.
Draws from a mixed strategy use no generator (:func:`pcs_racing.game.players.draw`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, is_dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, check_text, check_whole
from pcs_racing.game.identity import check_same_game
from pcs_racing.game.players import Competitor, Turn, draw
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import PolicySet
from pcs_racing_agents.base.fingerprint import fingerprint

Strategy = Callable[[NDArray[np.float32]], NDArray[np.float64]]
"""``strategy(observation (B, D)) -> (B, M)``: probabilities of the moves; each row sums to 1."""


@dataclass(frozen=True, eq=False)
class Agent:
    """A strategy of the game, with a name and a seed."""

    name: str  #: Name in tables.
    #: Function ``strategy(observation (B, D)) -> (B, M)``: the probabilities of the moves. A row
    #: depends on its observation alone. A dataclass with ``__call__`` can be sent to other
    #: processes; its fields identify it.
    strategy: Strategy
    spec: RaceGame  #: Game that the agent is made for, on any track.
    seed: int = 0  #: Seed of the random draws of a mixed strategy, from 0 to 2**63 - 1.
    #: Facts for documentation and reports: behaviour, source, training, digest of the weights.
    facts: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_text("an agent's name", self.name)
        check_whole(f"the seed of agent {self.name!r}", self.seed, 0, 2**63 - 1)
        object.__setattr__(self, "facts", dict(self.facts))
        object.__setattr__(self, "spec", self.spec.anywhere)

    def __repr__(self) -> str:
        spec = self.spec
        return f"<Agent {self.name!r}: archive {spec.archive.name!r}, {spec.rules.name} rules>"

    @property
    def content_hash(self) -> str:
        """SHA-256 of all that the moves depend on, without the name, for a dataclass strategy."""
        archive, rules = self.spec.archive.content_hash, replace(self.spec.rules, stay=True)
        return fingerprint(self.strategy, int(self.seed), archive, rules)

    def check_fits(self, game: RaceGame) -> None:
        """Check that a game has the archive, moves and observations that this agent is made for."""
        check_same_game(self.spec.identity, game.identity, f"agent {self.name!r}")

    def probabilities(self, observation: ArrayLike) -> NDArray[np.float64]:
        """Return the probabilities of the moves, shape (B, M), for observations of shape (B, D)."""
        rows = np.asarray(observation, np.float32)
        size = len(self.spec.observation_elements)
        if rows.ndim != 2 or rows.shape[1] != size:
            raise InputError(
                f"agent {self.name!r} got observations of shape {np.shape(observation)}; it takes"
                f" (B, {size})"
            )
        if not np.isfinite(rows).all():
            raise InputError(f"agent {self.name!r} got an observation that holds NaN or infinity")
        if len(rows) == 0:
            return np.zeros((0, len(self.spec.moves)))
        return self.strategy(rows)

    def act(self, observations: ArrayLike, turn: Turn | None = None) -> NDArray[np.int64]:
        """Return moves, indices in :attr:`RaceGame.moves`, shape (B,), for observations (B, D).

        The same observation always gives the same move, since it holds all earlier observations of
        the game: a mixed strategy draws the move by a hash of the observation and the agent's seed.
        """
        rows = np.asarray(observations, np.float32)
        return draw(self.probabilities(rows), rows, self.seed)


def competitor_hash(competitor: Competitor) -> str:
    """Return the SHA-256 of all that a competitor's moves depend on.

    It identifies the competitor in folders of results.
    """
    if isinstance(competitor, PolicySet):
        return _policies_hash(competitor)
    model = getattr(competitor, "model", competitor)
    state = getattr(getattr(model, "policy", None), "state_dict", None)
    if callable(state):
        return fingerprint({key: tensor.detach().cpu().numpy() for key, tensor in state().items()})
    behaviour = model.strategy if isinstance(model, Agent) else model
    if is_dataclass(behaviour) or isinstance(getattr(behaviour, "content_hash", None), str):
        return model.content_hash if isinstance(model, Agent) else fingerprint(behaviour)
    raise InputError(
        f"results of agent {getattr(competitor, 'name', '')!r} cannot be cached: "
        "it has no content hash; make it a dataclass, or give it a content_hash"
    )


def _policies_hash(policies: PolicySet) -> str:
    """Return the SHA-256 of a planner's name, parameters and network weights."""
    planner = policies.planner
    hashes = [
        getattr(one, "content_hash", None) for one in (planner.drive, planner.plan, planner.control)
    ]
    return fingerprint(
        planner.name,
        planner.parameter_names,
        [policy.parameters for policy in policies.policies],
        *[one for one in hashes if one is not None],
    )
