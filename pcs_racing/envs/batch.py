"""The protocol of a batch of episodes, over which all environments are written.

A batch advances E episodes at once, each with one or more players: an environment is one player's view of an episode.
Environment ``i`` belongs to player ``i % players`` of episode ``i // players``. Each episode draws from a generator of
its own, so a batch of any size gives the same numbers. What happens when an episode ends is not the batch's business:
:class:`pcs_racing.envs.single.SingleEnv` and :class:`pcs_racing.envs.vector.BatchVectorEnv` see to that.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_whole
from pcs_racing.race.rendering import Renderer

MOST_EPISODES = 100_000


class BatchStep(NamedTuple):
    """What a step of n environments returns, in fresh arrays."""

    observations: NDArray[np.float32]  #: shape (n, D)
    rewards: NDArray[np.float64]  #: shape (n,)
    terminated: NDArray[np.bool_]  #: shape (n,)
    truncated: NDArray[np.bool_]  #: shape (n,)


class Batch(Protocol):
    """Many episodes side by side."""

    episodes: int
    players: int  #: Of each episode.
    cars: int  #: Of each episode.
    codes: Mapping[str, Mapping[int, str]]  #: Words of those infos that are codes.
    reset_options: tuple[str, ...]  #: Options that :meth:`restart` takes.
    horizon: int  #: Steps of an episode that does not end early.
    frame_rate: int  #: Steps in a second of racing, or 1 if a step is longer.
    #: Frames for each second of racing in :meth:`film`; None where a step is short enough to be a single frame.
    film_rate: int | None

    @property
    def observation_space(self) -> Any:
        """Of one environment."""

    @property
    def action_space(self) -> Any:
        """Of one environment."""

    @property
    def elements(self) -> Sequence[Any]:
        """Name, unit, bounds and meaning of each number of an observation."""

    @property
    def track(self) -> Any:
        """The circuit."""

    def check_actions(self, actions: Any, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return actions of ``shape`` (a batch's, or () for one environment) as this batch's ``step`` takes them."""

    def restart(
        self, rows: NDArray[np.int64], generators: Sequence[np.random.Generator], options: Mapping[str, Any] = ...
    ) -> None:
        """Begin new episodes in some places, each drawn from its own generator."""

    def forget(self, rows: NDArray[np.int64]) -> None:
        """Let what lasts for several episodes begin anew, as the generators of some episodes do."""

    def step(self, actions: NDArray[Any], generators: Sequence[np.random.Generator]) -> BatchStep:
        """Make a step in every episode; those that are over stand still."""

    def observe(self, rows: NDArray[np.int64], out: NDArray[np.float32]) -> None:
        """Write the observations of some episodes into the rows of their environments, ``out`` of shape (n, D)."""

    def both_views(self) -> NDArray[np.float32]:
        """What each car of every episode observes, whoever drives it, shape (episodes, cars, D)."""

    def infos(self) -> dict[str, NDArray[Any]]:
        """Infos of all environments: arrays of n numbers by name."""

    def info(self, environment: int) -> dict[str, Any]:
        """Info of one environment."""

    def draw(self, renderer: Renderer, environment: int) -> NDArray[np.uint8] | None:
        """Draw an environment's race as it stands."""

    def film(
        self, renderer: Renderer, environment: int, ticks: int | None = None, step: Any = None
    ) -> Iterator[NDArray[np.uint8] | None]:
        """Draw a step of an environment, by default the last, a frame every so many simulation steps of 0.01 s."""

    def get_state(self) -> tuple[Any, ...]:
        """Return copies of all that changes."""

    def set_state(self, state: tuple[Any, ...]) -> None:
        """Continue from what :meth:`get_state` returned, here or in an equal batch."""

    def close(self) -> None:
        """Free threads."""


def check_batch_size(episodes: int, threads: int | None) -> None:
    """Check the number of environments of a batch, and of threads."""
    check_whole("num_envs", episodes, 1, MOST_EPISODES)
    if threads is not None:
        check_whole("threads", threads, 1)
