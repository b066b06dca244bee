"""Who can race: an agent moves between the policies of an archive, a driver keeps to a policy of its own.

An :class:`Agent` answers ``predict(observation)`` as a model of Stable-Baselines3 does; wherever an agent may stand,
such a model may stand, too. An agent is a value: a function from what is seen to the chances of the moves, and a seed.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.competitor import Competitor, Decider, PolicySet, Predictor
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.registry import get_planner, planner_names
from pcs_racing_agents.agents.drawing import draw
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.jobs.fingerprint import fingerprint

__all__ = ["Agent", "Competitor", "Decider", "Driver", "Strategy", "as_competitor", "competitor_hash"]

Strategy = Callable[[NDArray[np.float32]], NDArray[np.float64]]
"""``strategy(observation (B, D)) -> (B, M)``: chances of the moves, each row adding up to 1."""


@dataclass(frozen=True, eq=False)
class Agent:
    """A strategy of the game of moves.

    Attributes
    ----------
    name : str
        What tables call it.
    strategy : callable
        ``strategy(observation (B, D)) -> (B, M)``: the chances of the moves, row by row, whatever else is in the batch.
        A dataclass with ``__call__`` can be sent to other processes, and is told apart by its fields.
    setting : Setting
        The archive and the rules that it is made for.
    seed : int
        What a mixed strategy draws with, from 0 to 2**63 - 1.
    facts : Mapping of str to str
        What documentation and reports say: what it does, its source, what it was trained on, a digest of its weights.
    """

    name: str
    strategy: Strategy
    setting: Setting
    seed: int = 0
    facts: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InputError(f"an agent's name is {self.name!r}; it must be a non-empty text")
        if isinstance(self.seed, bool) or not isinstance(self.seed, int | np.integer) or not 0 <= self.seed < 2**63:
            raise InputError(f"the seed of agent {self.name!r} is {self.seed!r}; it must be a whole number from 0")
        object.__setattr__(self, "facts", dict(self.facts))

    def __repr__(self) -> str:
        return f"<Agent {self.name!r}: archive {self.setting.archive.name!r}, {self.setting.race} rules>"

    @property
    def content_hash(self) -> str:
        """SHA-256 of all that decides what it does, but not of its name; for a strategy that is a dataclass."""
        setting = self.setting
        return fingerprint(self.strategy, int(self.seed), setting.archive.content_hash, setting.config)

    def check_fits(self, game: RaceGame) -> None:
        """Check that a game is played with the archive, moves and observations that this agent is made for."""
        self.setting.check_fits(game, self.name)

    def probabilities(self, observation: ArrayLike) -> NDArray[np.float64]:
        """Return the chances of the moves, shape (B, M), for observations of shape (B, D).

        Raises
        ------
        InputError
            If an observation has the wrong size or is not finite.
        """
        seen = np.asarray(observation, np.float32)
        size = len(self.setting.elements)
        if seen.ndim != 2 or seen.shape[1] != size:
            raise InputError(
                f"agent {self.name!r} got an observation of shape {np.shape(observation)}; it takes ({size},) or "
                f"(B, {size})"
            )
        if not np.isfinite(seen).all():
            raise InputError(f"agent {self.name!r} got an observation that holds NaN or infinity")
        if len(seen) == 0:
            return np.zeros((0, len(self.setting.moves)))
        return self.strategy(seen)

    def predict(
        self,
        observation: ArrayLike,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, None]:
        """Return moves as a model of Stable-Baselines3 would.

        Parameters
        ----------
        observation : array_like, shape (D,) or (B, D)
        state, episode_start
            Not used: an observation holds all that was seen before.
        deterministic : bool
            Not used: the same observation always gives the same move. A mixed strategy draws it by a hash of what was
            seen and the agent's seed.

        Returns
        -------
        actions : ndarray of int, shape () or (B,)
            Indices in :attr:`Setting.moves`.
        state : None
        """
        seen = np.asarray(observation, np.float32)
        rows = seen[None] if seen.ndim == 1 else seen
        actions = draw(self.probabilities(rows), rows, self.seed)
        return (actions.reshape(()) if seen.ndim == 1 else actions), None


@dataclass(frozen=True, eq=False)
class Driver(PolicySet):
    """Policies from outside the archive, each a variant of one driver; it makes no moves.

    Attributes
    ----------
    name : str
        What tables call it.
    policies : tuple of Policy
        At least one; all of one planner.
    facts : Mapping of str to str
        What documentation and reports say.
    """

    facts: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "policies", tuple(self.policies))
        object.__setattr__(self, "facts", dict(self.facts))
        if len(self.policies) == 0:
            raise InputError(f"driver {self.name!r} has no policy; it needs at least one")
        others = {policy.planner.name for policy in self.policies if policy.planner is not self.planner}
        if others:
            raise InputError(
                f"driver {self.name!r} has policies of planner {self.planner.name!r} and of "
                f"{', '.join(map(repr, sorted(others)))}; all must be of one planner"
            )

    def __repr__(self) -> str:
        return f"<Driver {self.name!r}: {len(self.policies)} policies of planner {self.planner.name!r}>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle a planner that is registered by its name: it then is the same object in the other process."""
        planner: Planner | str = self.planner
        if self.planner.name in planner_names() and get_planner(self.planner.name) is self.planner:
            planner = self.planner.name
        rows = [(policy.parameters, policy.name) for policy in self.policies]
        return _driver, (self.name, planner, rows, dict(self.facts))

    @property
    def planner(self) -> Planner:
        """The family that its policies belong to."""
        return self.policies[0].planner

    @property
    def content_hash(self) -> str:
        """SHA-256 of its planner's name, its parameters, and the weights that its code holds, but not of its name."""
        weights = [self.facts["weights sha256"]] if "weights sha256" in self.facts else []
        return fingerprint(
            self.planner.name, self.planner.parameter_names, [p.parameters for p in self.policies], *weights
        )


def _driver(name: str, planner: Planner | str, rows: list[tuple[Any, str]], facts: dict[str, str]) -> Driver:
    family = get_planner(planner) if isinstance(planner, str) else planner
    return Driver(name, tuple(Policy(family, theta, policy) for theta, policy in rows), facts)


@dataclass(frozen=True, eq=False)
class Named:
    """A model under a name of your own.

    Attributes
    ----------
    name : str
    model : Predictor
    """

    name: str
    model: Predictor

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        """Ask the model."""
        return self.model.predict(observation, state, episode_start, deterministic)


def as_competitor(given: Any, name: str | None = None) -> Competitor:
    """Return something that can race: a policy becomes a driver, a model gets a name.

    Parameters
    ----------
    given : Agent, Driver, Policy, object with ``predict`` or with ``decide``
    name : str, optional
        Its name, where it is not to be the one it has.

    Raises
    ------
    InputError
        If it is nothing that can race.
    """
    if isinstance(given, Policy):
        return Driver(name or given.name, (given,))
    if isinstance(given, type) or not isinstance(given, Agent | Driver | Predictor | Decider):
        raise InputError(
            f"{given!r} can't race; it must be an agent, a driver, a policy, or an object with "
            "predict(observation, state, episode_start, deterministic)"
        )
    if name is None and not isinstance(getattr(given, "name", None), str):
        name = type(given).__name__
    if name is None or name == getattr(given, "name", None):
        return given
    if isinstance(given, Agent):
        return Agent(name, given.strategy, given.setting, given.seed, given.facts)
    if isinstance(given, Driver):
        return Driver(name, given.policies, given.facts)
    if isinstance(given, Predictor):
        return Named(name, given)
    if is_dataclass(given) and any(field.name == "name" for field in fields(given)):
        return replace(given, name=name)
    raise InputError(f"{given!r} has a name of its own, {given.name!r}; it can't be called {name!r}")


def competitor_hash(competitor: Competitor) -> str:
    """SHA-256 of all that decides what a competitor does, for folders of results.

    Raises
    ------
    InputError
        If nothing tells it from another one that does otherwise: a plain function, or an object that is neither a
        dataclass, nor a model of Stable-Baselines3, nor has a ``content_hash``.
    """
    model = competitor.model if isinstance(competitor, Named) else competitor
    state = getattr(getattr(model, "policy", None), "state_dict", None)
    if callable(state):
        return fingerprint({key: tensor.detach().cpu().numpy() for key, tensor in state().items()})
    what = model.strategy if isinstance(model, Agent) else model
    if isinstance(what, Driver) or is_dataclass(what) or isinstance(getattr(what, "content_hash", None), str):
        return model.content_hash if isinstance(model, Agent) else fingerprint(what)
    raise InputError(
        f"results of agent {getattr(competitor, 'name', '')!r} can't be kept in a folder: nothing tells it from "
        "another one of that name; make it a dataclass, or give it a content_hash"
    )
