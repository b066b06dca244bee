"""The regret approximator of the paper: a network that predicts the value of each move from an observation.

It needs no torch, takes a few microseconds for a decision, and never changes. How it is trained is in
:mod:`pcs_racing_agents.networks.training`, how it is stored in :mod:`pcs_racing_agents.networks.network_files`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_facts, check_text
from pcs_racing.base.dense import DenseLayers, dense_rows
from pcs_racing.base.errors import InputError
from pcs_racing.game.identity import GameIdentity, check_same_game, game_identity
from pcs_racing.game.rules import RaceGame

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class RegretNetwork:
    """``R_approx(h, e_k)`` of Equation 8 of the paper: all moves' values from one observation.

    ``h`` is encoded in an observation of the game, of a size that does not depend on how long the history is. Between
    the layers stand ReLUs; after the last one only if ``clipped``.

    Examples
    --------
    >>> from pcs_racing_agents.networks import load_network
    >>> network = load_network("paper")  # doctest: +SKIP
    >>> network(game.observation(state))  # doctest: +SKIP
    """

    name: str
    identity: GameIdentity  #: The game that it was made for.
    target: str  #: What it approximates (:data:`pcs_racing_agents.networks.targets.TARGETS`, or something else).
    clipped: bool  #: Whether values below 0 are shown as 0, as the paper does with regrets.
    layers: DenseLayers  #: D inputs and A outputs.
    mean: Floats  #: shape (D,): ``mean``, ``scale``: The first layer sees ``(observation - mean) / scale``.
    scale: Floats
    #: How it was trained and how well it does: texts and numbers by name.
    training: Mapping[str, str | int | float | bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        def assign(key: str, value: Any) -> None:
            object.__setattr__(self, key, value)

        for key in ("name", "target"):
            check_text(f"a network's {key}", getattr(self, key))
        where = f"network {self.name!r}"
        assign("training", check_facts(f"{where}: training", self.training))
        if not isinstance(self.identity, GameIdentity):
            raise InputError(f"{where}: identity is {self.identity!r}; it must be a GameIdentity")
        sizes = self.layers.sizes
        if sizes[0] != len(self.identity.elements):
            raise InputError(f"{where} has {sizes[0]} inputs; an observation has {len(self.identity.elements)} numbers")
        if sizes[-1] != len(self.identity.moves):
            raise InputError(f"{where} puts out {sizes[-1]} values; there are {len(self.identity.moves)} moves")
        for key in ("mean", "scale"):
            array = np.array(getattr(self, key), np.float32)
            if array.shape != sizes[:1] or not np.isfinite(array).all():
                raise InputError(f"{where}: {key} is {array!r:.80}; it must be {sizes[0]} finite numbers")
            array.setflags(write=False)
            assign(key, array)
        if not (self.scale > 0.0).all():
            raise InputError(f"{where}: scale is {self.scale.min():g} at its smallest; it must be above 0")
        # The scaling of the inputs is part of the first layer from here on: one pass less for every decision.
        first = self.layers.weights[0].astype(np.float64) / self.scale
        bias = self.layers.biases[0] - (first * self.mean).sum(axis=1)
        scaled = DenseLayers((first, *self.layers.weights[1:]), (bias, *self.layers.biases[1:]))
        assign("_sizes", np.array(sizes, np.int64))
        assign("_flat", scaled.flat())
        assign("_widest", max(sizes))

    def __repr__(self) -> str:
        """Show its sizes, target, archive and preset."""
        shape = "-".join(map(str, self.layers.sizes))
        return (
            f"<RegretNetwork {self.name!r}: {shape}, {self.target}, archive {self.identity.archive!r}, "
            f"preset {self.identity.preset!r}>"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by value (a read-only mapping can't be pickled)."""
        values = {**self.__dict__, "training": dict(self.training)}
        return RegretNetwork, tuple(values[key] for key in self.__dataclass_fields__)

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the D numbers that it sees."""
        return self.identity.elements

    @property
    def moves(self) -> tuple[str, ...]:
        """Names of the A moves that it values."""
        return self.identity.moves

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""
        return self.layers.hidden

    def __call__(self, observations: ArrayLike) -> Floats:
        """Value of each move, shape (..., A), for observations (..., D); see :attr:`clipped`.

        The values of an observation do not depend on what else is in the batch, not even in the last bit.
        """
        values = self.unclipped(observations)
        return np.maximum(values, np.float32(0.0)) if self.clipped else values

    def unclipped(self, observations: ArrayLike) -> Floats:
        """Value of each move before any clipping, shape (..., A)."""
        x = np.asarray(observations, np.float32)
        inputs, moves = len(self.identity.elements), len(self.identity.moves)
        if x.ndim == 0 or x.shape[-1] != inputs:
            raise InputError(f"observations have shape {x.shape}; network {self.name!r} needs (..., {inputs})")
        rows = np.ascontiguousarray(x.reshape(-1, inputs))
        out = np.empty((len(rows), moves), np.float32)
        scratch = np.empty((2, self._widest), np.float32)  # type: ignore[attr-defined]
        if not dense_rows(rows, self._flat, self._sizes, scratch, out):  # type: ignore[attr-defined]
            raise InputError("observations hold NaN or infinity; they must be finite")
        return out.reshape(*x.shape[:-1], moves)

    def choose(self, observations: ArrayLike, mask: ArrayLike | None = None) -> NDArray[np.int64]:
        """Index of the move to make, shape (...): the one of highest value (Equation 9 of the paper).

        Where all values are clipped to 0 the paper's choice is arbitrary; here it is the move of the highest value
        before clipping. Of equal values the first is taken.

        Parameters
        ----------
        observations : array_like, shape (..., D)
        mask : array_like of bool, shape (..., A), optional
            Moves that may be made, at least one of each row; all of them by default.
        """
        values = self.unclipped(observations)  # where one is above 0, clipping does not change which is the highest
        if mask is not None:
            allowed = np.asarray(mask)
            if allowed.dtype != np.bool_ or allowed.shape != values.shape:
                raise InputError(
                    f"the mask has shape {allowed.shape} and type {allowed.dtype}; it must have {values.shape} and bool"
                )
            if not allowed.any(axis=-1).all():
                raise InputError("the mask allows no move in some row; it must allow one")
            values = np.where(allowed, values, -np.inf)
        return np.argmax(values, axis=-1)

    def check_fits(self, game: RaceGame) -> None:
        """Check that a game has the observations and the moves of this network.

        A game may offer the move "stay" in addition: the network never makes it. Rules of the race that the network was
        not made for (the preset, the track, the length of a step) are no error: it may be tried there.
        """
        check_same_game(self.identity, game_identity(game), f"network {self.name!r}")
