"""Many duels at once, for one learner or for two that are the same."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.envs.drive_vector import Step, renewed_generators, with_masks
from pcs_racing.envs.duel_batch import DuelBatch
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing.game.game import RaceGame
from pcs_racing.race.config import RaceConfig
from pcs_racing.track.track import Track

__all__ = ["DuelVectorEnv", "DuelVectorState", "SelfPlayVectorEnv"]


class DuelVectorState(NamedTuple):
    """A moment of a :class:`DuelVectorEnv`: a value that can be kept, copied, pickled and restored."""

    games: tuple[Any, ...]
    generators: list[dict[str, Any]]


class DuelVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.int64], Any]):
    """Many :class:`pcs_racing.envs.duel.DuelEnv` in one, with the same numbers for the same seeds.

    Games that end begin anew in the same step (``AutoresetMode.SAME_STEP``): the observation returned is the first of
    the new game, and ``info["final_obs"]`` and ``info["final_info"]`` hold what the old one ended with. Environment
    ``i`` draws its games from its own generator, seeded with ``seed + i``.

    Parameters
    ----------
    num_envs : int
        Number of games.
    threads : int, optional
        Threads that share a step, all cores by default; the result does not depend on it.
    track, archive, opponent, race, deterministic_opponent, **settings
        As for :class:`pcs_racing.envs.duel.DuelEnv`.

    Raises
    ------
    InputError
        If an argument, an action or the order of calls is impossible; of actions and seeds the index is named.

    Examples
    --------
    >>> envs = DuelVectorEnv(4, opponent="never-switch")
    >>> observations, info = envs.reset(seed=1)
    >>> observations.shape
    (4, 31)
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012
    players = 1

    def __init__(
        self,
        num_envs: int = 1,
        *,
        track: Track | str | Path = "Tarnfjord",
        archive: PolicyArchive | str | Path = "default",
        opponent: Any = "random-moves",
        race: GameConfig | RaceConfig | str | Path = "paper",
        deterministic_opponent: bool = True,
        threads: int | None = None,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        if render_mode is not None:
            raise InputError(f"render_mode is {render_mode!r}; many duels can't be rendered, one DuelEnv can")
        if opponent is None and self.players == 1:
            raise InputError("opponent is None; name one, for instance 'random-moves'")
        self._arguments = dict(
            track=track,
            archive=archive,
            opponent=opponent,
            race=race,
            deterministic_opponent=deterministic_opponent,
            threads=threads,
            **settings,
        )
        games, rest = divmod(num_envs, self.players) if isinstance(num_envs, int | np.integer) else (num_envs, 0)
        if rest:
            raise InputError(f"num_envs is {num_envs}; it must be even, two for each game")
        self._batch = DuelBatch(games, **self._arguments)
        self.num_envs = self._batch.games * self.players
        self.single_observation_space = spaces.Box(self._batch.low, self._batch.high, dtype=np.float32)
        self.single_action_space = spaces.Discrete(len(self.game.move_names))
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._rngs: list[np.random.Generator] = []

    @property
    def game(self) -> RaceGame:
        """The rules."""
        return self._batch.game

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin a new game everywhere.

        Parameters
        ----------
        seed : int or list of int, optional
            Game ``i`` begins anew with ``seed + i``, or with its entry of the list; where it is None its generator goes
            on.
        options : dict, optional
            Ignored.
        """
        self._rngs = renewed_generators(self._rngs, seed, self._batch.games)
        self._batch.restart(np.arange(self._batch.games), self._rngs)
        return self._observations(), with_masks(self._facts(), np.ones(self.num_envs, np.bool_))

    def step(self, actions: NDArray[np.int64]) -> Step:
        """Let all cars move, and drive a step.

        Parameters
        ----------
        actions : array_like of int, shape (num_envs,)
            Moves.

        Returns
        -------
        observations : ndarray of float32, shape (num_envs, D)
        rewards : ndarray of float64, shape (num_envs,)
        terminations, truncations : ndarray of bool, shape (num_envs,)
        info : dict
        """
        moves = self._batch.check_actions(actions, self.players)
        utility, done = self._batch.step(moves, self._rngs)
        rewards = np.ascontiguousarray(utility[:, : self.players]).reshape(-1)
        over = np.repeat(done, self.players)
        final: dict[str, Any] = {}
        if done.any():
            last = np.full(self.num_envs, None, dtype=object)
            seen = self._observations()
            for i in np.flatnonzero(over):
                last[i] = seen[i]
            final = {"final_obs": last, "_final_obs": over.copy(), "_final_info": over.copy()}
            final["final_info"] = with_masks(self._facts(), over)
            rows = np.flatnonzero(done)
            self._batch.restart(rows, [self._rngs[i] for i in rows])
        info = with_masks(self._facts(), np.ones(self.num_envs, np.bool_))
        return self._observations(), rewards, over, np.zeros(self.num_envs, np.bool_), info | final

    def action_masks(self) -> NDArray[np.bool_]:
        """Moves that each player may make, shape (num_envs, M), as sb3-contrib's MaskablePPO asks for them."""
        masks = self.game.action_mask(self._batch.started())
        return masks[:, : self.players].reshape(self.num_envs, -1)

    def get_state(self) -> DuelVectorState:
        """Return all that the rest of the games, and all later ones, depend on."""
        return DuelVectorState(self._batch.get_state(), [dict(rng.bit_generator.state) for rng in self._rngs])

    def set_state(self, state: DuelVectorState) -> NDArray[np.float32]:
        """Go on from what `get_state` returned, here or in an environment with equal arguments.

        Returns the observations at that moment.
        """
        if not isinstance(state, DuelVectorState):
            raise InputError(f"state is a {type(state).__name__}; it must be what get_state returned")
        self._batch.set_state(state.games)
        self._rngs = [seeding.np_random(0)[0] for _ in state.generators]
        for rng, given in zip(self._rngs, state.generators, strict=True):
            rng.bit_generator.state = given
        return self._observations()

    def _observations(self) -> NDArray[np.float32]:
        return self._batch.seen[:, : self.players].reshape(self.num_envs, -1).copy()

    def _facts(self) -> dict[str, NDArray[Any]]:
        return self._batch.facts()

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (type(self), self.num_envs, self._arguments, self.get_state())

    def __deepcopy__(self, memo: dict[int, Any]) -> "DuelVectorEnv":
        function, arguments = self.__reduce__()
        return function(*arguments)


class SelfPlayVectorEnv(DuelVectorEnv):
    """Games in which both cars belong to the agent: environment ``2 i`` is car 0 of game ``i``, ``2 i + 1`` its car 1.

    One policy that acts in all environments plays against itself; rewards of a pair add up to zero. Seeds belong to
    games: ``reset(seed=...)`` takes one for each game.

    Parameters
    ----------
    num_envs : int
        Twice the number of games.
    **arguments
        As for :class:`DuelVectorEnv`, without ``opponent``.
    """

    players = 2

    def __init__(self, num_envs: int = 2, **arguments: Any) -> None:
        if arguments.setdefault("opponent", None) is not None:
            raise InputError(f"opponent is {arguments['opponent']!r}; in self-play both cars belong to the agent")
        super().__init__(num_envs, **arguments)

    def _facts(self) -> dict[str, NDArray[Any]]:
        first, second = self._batch.facts(0), self._batch.facts(1)
        return {
            name: np.stack([first[name], second[name]], axis=1).reshape(self.num_envs, *first[name].shape[1:])
            for name in first
        }


def _rebuild(
    kind: type[DuelVectorEnv], num_envs: int, arguments: dict[str, Any], state: DuelVectorState
) -> DuelVectorEnv:
    env = kind(num_envs, **arguments)
    env.set_state(state)
    return env
