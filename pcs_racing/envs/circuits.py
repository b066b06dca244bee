"""Choice of the track of each episode: a fixed track, one of several, or a generated track."""

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import random_bits
from pcs_racing.envs.batch import MAX_STEPS, check_within
from pcs_racing.track.loading import as_track
from pcs_racing.track.track import Track

if TYPE_CHECKING:
    from pcs_racing.envs.random_circuits import CircuitBuilder

RANDOM = "random"


class Circuits:
    """Tracks of a batch of episodes, from the argument ``track`` of an environment.

    A random track is a function of a key and the number of episodes since the key was drawn. The
    environment's generator draws the key when it begins. The next track is built during the
    current episodes.
    """

    def __init__(self, source: Any, episodes: int) -> None:
        listed = source if isinstance(source, list | tuple) else [source]
        random = isinstance(source, str) and source == RANDOM
        known = listed and all(isinstance(one, str | PathLike | Track) for one in listed)
        #: Builder of random tracks; None for given tracks.
        self._builder = None if known and not random else _builder(source, episodes)
        self._listed: list[Track] = [] if self._builder else [as_track(one) for one in listed]
        #: shape (episodes,), int: Number of each episode's track: its index in the list, or the
        #: number of the random track.
        self.number = np.zeros(episodes, np.int64)
        self._keys = np.zeros(episodes, np.uint64)
        self._past = np.full(episodes, -1)  # episodes since the key was drawn

    @property
    def several(self) -> bool:
        """True if episodes may be on different tracks."""
        return len(self._listed) != 1

    @property
    def codes(self) -> Mapping[int, str]:
        """Names of the tracks by number."""
        return (
            _RandomNames()
            if self._builder
            else {i: track.name for i, track in enumerate(self._listed)}
        )

    def track(self, number: int) -> Track:
        """Return a track by its number."""
        return self._listed[number] if self._builder is None else self._builder.get(int(number))

    def forget(self, rows: NDArray[np.int64]) -> None:
        """Restart the track sequences of some episodes, with their generators."""
        self._past[rows] = -1

    def draw(self, rows: NDArray[np.int64], generators: Sequence[np.random.Generator]) -> None:
        """Draw the tracks of new episodes, each from its own generator.

        With a single track nothing is drawn.
        """
        if self._builder is None:
            if self.several:
                self.number[rows] = [
                    generator.integers(len(self._listed)) for generator in generators
                ]
            return
        # The generator is used once. Later tracks follow from the key, so they can be built early.
        for row, generator in zip(rows, generators, strict=True):
            if self._past[row] < 0:
                self._keys[row] = generator.integers(2**63)
            self._past[row] += 1
            self.number[row] = self._nth(row, 0)
        for shift in (0, 1):  # all current tracks before any next track
            for row in rows:
                self._builder.ahead(self._nth(row, shift))

    def _nth(self, row: int, shift: int) -> int:
        """Return the number of an environment's current track, or of a later track."""
        settings = self._builder.settings  # type: ignore[union-attr]
        turn = int(self._past[row]) // settings.episodes + shift
        return int(random_bits(self._keys[row : row + 1], turn)[0, 0] % np.uint64(settings.count))

    @property
    def _identity(self) -> str:
        """Content hashes of the listed tracks, or the settings of random tracks."""
        if self._builder is not None:
            return str(self._builder.settings)
        return " ".join(track.content_hash or track.name for track in self._listed)

    def get_state(self) -> tuple[Any, ...]:
        """Return copies of all variables, and the identity of the tracks."""
        return self.number.copy(), self._keys.copy(), self._past.copy(), self._identity

    def check_state(self, state: tuple[Any, ...]) -> None:
        """Refuse a state that `get_state` can't have returned; its shapes are checked before."""
        if state[3] != self._identity:
            raise InputError(
                "the state's circuits have other content hashes than the circuits of this"
                " environment; use the get_state() of an environment with equal arguments"
            )
        last = len(self._listed) - 1 if self._builder is None else self._builder.settings.count - 1
        check_within("the state's circuits", state[0], 0, last)
        check_within("the state's episodes on a circuit", state[2], -1, MAX_STEPS)

    def set_state(self, state: tuple[Any, ...]) -> None:
        """Continue from a state of `get_state`."""
        self.number[:], self._keys[:], self._past[:], _ = state

    def close(self) -> None:
        """Stop building tracks."""
        if self._builder is not None:
            self._builder.close()


def _builder(source: Any, episodes: int) -> "CircuitBuilder":
    """Return the builder of the tracks of an argument that names no track."""
    from pcs_racing.envs.random_circuits import CircuitBuilder, RandomCircuits

    settings = RandomCircuits() if isinstance(source, str) else source
    if not isinstance(settings, RandomCircuits):
        raise InputError(
            f"track is {source!r:.200}; it must be a circuit's name, its folder, a Track, a list of"
            f" these, {RANDOM!r} or RandomCircuits"
        )
    return CircuitBuilder(settings, episodes)


class _RandomNames(dict[int, str]):
    """Names of random tracks by number; there are too many to list."""

    def __missing__(self, number: int) -> str:
        return f"random-{number}"
