"""Competitors: agents, which switch between the policies of an archive, and fixed policies.

An :class:`Agent` is a value: a seed and a function from observations to the probabilities of the
moves. Any other object with ``act`` (:class:`pcs_racing.game.competitor.SupportsAct`) can replace
it. Draws from a mixed strategy use no generator: a draw is a hash of the observation and the seed.
The same agent makes the same move for the same observation, in a batch of any size and in any
order, so a race can be simulated again to the last bit. To an opponent that does not know the seed,
the moves are as good as random.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_text, check_whole
from pcs_racing.base.compilation import kernel
from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import GOLDEN, scramble_one
from pcs_racing.game import competitor as players
from pcs_racing.game.competitor import Competitor, PolicySet, Turn, competitor_name, is_model
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing_agents.agents.game_spec import GameSpec
from pcs_racing_agents.base.fingerprint import fingerprint


@kernel
def _hash(words, seed, out):
    first = scramble_one((seed + np.uint64(1)) * GOLDEN)
    for row in range(words.shape[0]):
        state = first
        for column in range(words.shape[1]):
            state = scramble_one((state ^ np.uint64(words[row, column])) + GOLDEN)
        out[row] = state


def hash_rows(rows: NDArray[np.float32], seed: int) -> NDArray[np.uint64]:
    """Return a 64-bit hash of each row (B, D): splitmix64 (Steele et al. 2014) over its words."""
    # -0 and 0 are the same number
    words = np.ascontiguousarray(rows + np.float32(0.0)).view(np.uint32)
    out = np.empty(len(rows), np.uint64)
    _hash(words, np.uint64(seed), out)
    return out


def draw(
    probabilities: NDArray[np.float64], observations: NDArray[np.float32], seed: int
) -> NDArray[np.int64]:
    """Draw a column of each row of probabilities (B, M) by the hash of the observation (B, D).

    The columns have shape (B,).
    """
    share = (hash_rows(observations, seed) >> np.uint64(11)).astype(np.float64) * 2.0**-53
    edges = np.cumsum(probabilities, axis=1)
    # The share is scaled by the total: rounding in the sum never leaves a gap at the end.
    column = (edges <= (share * edges[:, -1])[:, None]).sum(axis=1)
    last = probabilities.shape[1] - 1 - np.argmax(probabilities[:, ::-1] > 0.0, axis=1)
    return np.minimum(column, last)


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
    spec: GameSpec  #: Archive and rules that the agent is made for.
    seed: int = 0  #: Seed of the random draws of a mixed strategy, from 0 to 2**63 - 1.
    #: Facts for documentation and reports: behaviour, source, training, digest of the weights.
    facts: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_text("an agent's name", self.name)
        check_whole(f"the seed of agent {self.name!r}", self.seed, 0, 2**63 - 1)
        object.__setattr__(self, "facts", dict(self.facts))

    def __repr__(self) -> str:
        return f"<Agent {self.name!r}: archive {self.spec.archive.name!r}, {self.spec.race} rules>"

    @property
    def content_hash(self) -> str:
        """SHA-256 of all that the moves depend on, without the name, for a dataclass strategy."""
        spec = self.spec
        return fingerprint(self.strategy, int(self.seed), spec.archive.content_hash, spec.config)

    def check_fits(self, game: RaceGame) -> None:
        """Check that a game has the archive, moves and observations that this agent is made for."""
        self.spec.check_fits(game, self.name)

    def probabilities(self, observation: ArrayLike) -> NDArray[np.float64]:
        """Return the probabilities of the moves, shape (B, M), for observations of shape (B, D)."""
        rows = np.asarray(observation, np.float32)
        size = len(self.spec.elements)
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
        """Return moves, indices in :attr:`GameSpec.moves`, shape (B,), for observations (B, D).

        The same observation always gives the same move, since it holds all earlier observations of
        the game: a mixed strategy draws the move by a hash of the observation and the agent's seed.
        """
        rows = np.asarray(observations, np.float32)
        return draw(self.probabilities(rows), rows, self.seed)


@dataclass(frozen=True, eq=False)
class Driver(PolicySet):
    """A competitor without moves: one or more policies (variants) of one planner."""

    facts: Mapping[str, str] = field(default_factory=dict)  #: Facts for documentation and reports.

    def __post_init__(self) -> None:
        object.__setattr__(self, "policies", tuple(self.policies))
        object.__setattr__(self, "facts", dict(self.facts))
        if len(self.policies) == 0:
            raise InputError(f"fixed policy {self.name!r} has no policy; it needs at least one")
        others = {
            policy.planner.name for policy in self.policies if policy.planner is not self.planner
        }
        if others:
            raise InputError(
                f"fixed policy {self.name!r} has policies of planner {self.planner.name!r} and of "
                f"{', '.join(map(repr, sorted(others)))}; all must be of one planner"
            )

    def __repr__(self) -> str:
        return (
            f"<Driver {self.name!r}: {len(self.policies)} policies of planner"
            f" {self.planner.name!r}>"
        )

    @property
    def planner(self) -> Planner:
        """Planner of the policies."""
        return self.policies[0].planner

    @property
    def content_hash(self) -> str:
        """SHA-256 of the planner's name, parameters and network weights, without the own name."""
        drives = (self.planner.drive, self.planner.plan, self.planner.control)
        hashes = [getattr(one, "content_hash", None) for one in drives]
        weights = [one for one in hashes if one is not None]
        return fingerprint(
            self.planner.name,
            self.planner.parameter_names,
            [p.parameters for p in self.policies],
            *weights,
        )


def as_agent(candidate: Any, name: str | None = None) -> Competitor:
    """Convert an object to an agent, or to a :class:`Driver` without moves.

    Parameters
    ----------
    candidate : Agent, Driver, Policy, or object with ``act`` or with ``predict``
        A model whose actions are steering and speed, also its file, becomes a :class:`Driver`
        (:func:`pcs_racing.envs.models.model_policy`). Other objects are converted by
        :func:`pcs_racing.game.competitor.as_agent`.
    name : str, optional
        New name, in place of the candidate's name.
    """
    if is_model(candidate):
        candidate = model_policy(candidate, name)
    agent = players.as_agent(candidate, name)
    if isinstance(agent, players.FunctionAgent | players.RandomMoves):
        raise InputError(
            f"{candidate!r} can't race here; it draws with the generators of an environment, so"
            " give an agent, a policy, or an object with act or predict"
        )
    if isinstance(agent, PolicySet) and not isinstance(agent, Driver):
        return Driver(agent.name, agent.policies)
    return agent


def model_policy(model: Any, name: str | None = None) -> Policy:
    """Return the policy of a model for steering and speed, or of its file."""
    from pcs_racing.envs import models
    from pcs_racing_agents.agents.sb3_files import load_model, plain_model

    if isinstance(model, str | Path):
        return load_model(model)
    name = name or competitor_name(model)
    like = model.get_env() if callable(getattr(model, "get_env", None)) else None
    return models.model_policy(plain_model(model, name), name=name, like=like)


def competitor_hash(competitor: Competitor) -> str:
    """Return the SHA-256 of all that a competitor's moves depend on.

    It identifies the competitor in folders of results.
    """
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
