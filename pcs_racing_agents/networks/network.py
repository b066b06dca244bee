"""Regret approximator of the paper: a network for the value of each move from an observation.

It needs no torch, takes a few microseconds for a decision, and never changes.
:mod:`pcs_racing_agents.networks.training` trains it,
:mod:`pcs_racing_agents.networks.network_files` stores it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import InputError, check_array, check_facts, check_flag, check_text
from pcs_racing.base.typing import Singles
from pcs_racing.game.identity import GameIdentity, check_same_game
from pcs_racing.game.rules import RaceGame


@dataclass(frozen=True, eq=False)
class RegretNetwork:
    """Regret network, ``R_approx(h, e_k)`` of the paper (Equation 8): values of all moves.

    An observation of the game encodes ``h``; its size does not depend on the length of the
    history. ReLUs separate the layers; a ReLU follows the last layer only if ``clipped``.

    Examples
    --------
    >>> from pcs_racing_agents.networks import load_network
    >>> network = load_network("paper")  # doctest: +SKIP
    >>> network(game.observation(state))  # doctest: +SKIP
    """

    name: str
    identity: GameIdentity  #: Game that the network was made for.
    #: Kind of the values (:data:`pcs_racing_agents.networks.rows.TARGETS`, or another text).
    target: str
    clipped: bool  #: True if values below 0 are returned as 0, as regrets in the paper.
    layers: DenseLayers  #: D inputs and A outputs.
    #: shape (D,): ``mean``, ``scale``: Scaling of inputs: ``(observation - mean) / scale``.
    mean: Singles
    scale: Singles
    #: Facts about training and evaluation: texts and numbers by name.
    training: Mapping[str, str | int | float | bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        def assign(key: str, value: Any) -> None:
            object.__setattr__(self, key, value)

        for key in ("name", "target"):
            check_text(f"a network's {key}", getattr(self, key))
        where = f"network {self.name!r}"
        check_flag(f"{where}: clipped", self.clipped)
        assign("training", check_facts(f"{where}: training", self.training))
        sizes = self.layers.sizes
        if sizes[0] != len(self.identity.elements):
            raise InputError(
                f"{where} has {sizes[0]} inputs; an observation has {len(self.identity.elements)}"
                " numbers"
            )
        if sizes[-1] != len(self.identity.moves):
            raise InputError(
                f"{where} puts out {sizes[-1]} values; there are {len(self.identity.moves)} moves"
            )
        for key in ("mean", "scale"):
            array = check_array(f"{where}: {key}", getattr(self, key), sizes[:1]).astype(np.float32)
            array.setflags(write=False)
            assign(key, array)
        if not (self.scale > 0.0).all():
            raise InputError(
                f"{where}: scale is {self.scale.min():g} at its smallest; it must be above 0"
            )

    @cached_property
    def scaled_layers(self) -> DenseLayers:
        """Layers with the scaling of the inputs in the first one: one pass less for a decision."""
        first = self.layers.weights[0].astype(np.float64) / self.scale
        bias = self.layers.biases[0] - (first * self.mean).sum(axis=1)
        return DenseLayers((first, *self.layers.weights[1:]), (bias, *self.layers.biases[1:]))

    def __repr__(self) -> str:
        """Show its sizes, target, archive and rules."""
        shape = "-".join(map(str, self.layers.sizes))
        return (
            f"<RegretNetwork {self.name!r}: {shape}, {self.target}, archive"
            f" {self.identity.archive!r}, rules {self.identity.rules!r}>"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by value (a read-only mapping can't be pickled)."""
        values = {**self.__dict__, "training": dict(self.training)}
        return RegretNetwork, tuple(values[key] for key in self.__dataclass_fields__)

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the D inputs."""
        return self.identity.elements

    @property
    def moves(self) -> tuple[str, ...]:
        """Names of the A moves."""
        return self.identity.moves

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""
        return self.layers.hidden

    def __call__(self, observations: ArrayLike) -> Singles:
        """Return the value of each move, shape (..., A), for observations (..., D).

        See :attr:`clipped`. The values of an observation do not depend on the rest of the batch,
        not even in the last bit.
        """
        values = self.unclipped(observations)
        return np.maximum(values, np.float32(0.0)) if self.clipped else values

    def unclipped(self, observations: ArrayLike) -> Singles:
        """Return the value of each move before any clipping, shape (..., A)."""
        x = np.asarray(observations, np.float32)
        inputs = len(self.identity.elements)
        if x.ndim == 0 or x.shape[-1] != inputs:
            raise InputError(
                f"observations have shape {x.shape}; network {self.name!r} needs (..., {inputs})"
            )
        if not np.isfinite(x).all():
            raise InputError("observations hold NaN or infinity; they must be finite")
        return self.scaled_layers.forward(x)

    def choose(self, observations: ArrayLike) -> NDArray[np.int64]:
        """Return the index of the move with the highest value, shape (...) (paper, Equation 9).

        If all values are clipped to 0, the choice of the paper is arbitrary; this function returns
        the move with the highest value before clipping. Of equal values the first is chosen.
        """
        return np.argmax(self.unclipped(observations), axis=-1)

    def check_fits(self, game: RaceGame) -> None:
        """Check that a game has the observations and the moves of this network.

        A game may offer the move "stay" in addition: the network never makes it. Other rules of the
        race (track, length of a step) are no error: the network may be tried there.
        """
        check_same_game(self.identity, game.identity, f"network {self.name!r}")
