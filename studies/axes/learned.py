"""Learned characteristics: axes that are weighted sums of other characteristics and of their products.

Where the weights come from is not stated here; an axis only has to be computable from a
:class:`~pcs_racing.game.characteristics.Segment`, as all others are.
"""

import hashlib
import json
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.artifacts import ManifestFormat
from pcs_racing.base.checks import check_facts, check_names, check_number, check_text, check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.game.characteristics import (
    Characteristic,
    Segment,
    get_characteristics,
    measure,
    register_characteristic,
)

Floats = NDArray[np.float64]

BOUND = 4.0
"""Standard deviations at which inputs are cut off: a segment of a few ticks must not give an extreme value."""
TIMES = " * "
"""Between the factors of a term."""
MOST_FACTORS = 3
_LARGEST = 1e6

LEARNED_FORMAT = ManifestFormat(
    "set of characteristics", ("name", "inputs", "axes", "training", "sha256"), "save_learned"
)
"""Of a file: a YAML manifest of names, scales and weights, readable by people."""


@dataclass(frozen=True)
class LearnedInput:
    """A characteristic that learned ones are made of, and the scale on which it enters."""

    name: str  #: Of a registered characteristic.
    mean: float  #: The input is ``(value - mean) / scale``, limited to +-:data:`BOUND`.
    scale: float

    def __post_init__(self) -> None:
        check_text("an input's name", self.name)
        object.__setattr__(self, "mean", float(check_number(f"mean of {self.name}", self.mean, -_LARGEST, _LARGEST)))
        object.__setattr__(self, "scale", float(check_number(f"scale of {self.name}", self.scale, 1e-9, _LARGEST)))


@dataclass(frozen=True)
class LearnedAxis:
    """One learned characteristic."""

    name: str  #: Under which it is registered.
    meaning: str  #: One line for the reader.
    intercept: float
    #: Terms and their weights; a term is an input or a product: ``"speed"``, ``"speed * restraint"``.
    weights: tuple[tuple[str, float], ...]

    def __post_init__(self) -> None:
        check_text("an axis' name", self.name)
        check_text(f"meaning of {self.name}", self.meaning)
        number = check_number(f"intercept of {self.name}", self.intercept, -_LARGEST, _LARGEST)
        object.__setattr__(self, "intercept", float(number))
        if not isinstance(self.weights, tuple) or not 1 <= len(self.weights) <= 1000:
            raise InputError(f"weights of {self.name} are {self.weights!r:.80}; there must be 1 to 1000")
        weights = [(term, check_number(f"weight {term!r}", w, -_LARGEST, _LARGEST)) for term, w in self.weights]
        check_names(f"terms of {self.name}", [term for term, _ in weights])
        object.__setattr__(self, "weights", tuple((term, float(weight)) for term, weight in weights))


@dataclass(frozen=True)
class LearnedCharacteristics:
    """A set of learned characteristics with common inputs: a plain value, made of names and numbers."""

    name: str  #: Small letters, digits, ``_`` and ``-``; the names of the axes begin with it.
    inputs: tuple[LearnedInput, ...]
    axes: tuple[LearnedAxis, ...]
    #: How they were learned: texts and numbers by name. Not part of :attr:`content_hash`.
    training: Mapping[str, str | int | float | bool] = field(default_factory=dict, compare=False)

    def __post_init__(self) -> None:
        check_set_name(self.name)
        for key, kind in (("inputs", LearnedInput), ("axes", LearnedAxis)):
            values = getattr(self, key)
            if not isinstance(values, tuple) or not all(isinstance(value, kind) for value in values):
                raise InputError(f"{key} of {self.name} are {values!r:.80}; they must be a tuple of {kind.__name__}")
            check_whole(f"number of {key} of {self.name}", len(values), 1, 50)
        inputs = check_names(f"inputs of {self.name}", [given.name for given in self.inputs])
        for axis in self.axes:
            if not axis.name.startswith(f"{self.name}_"):
                raise InputError(f"axis {axis.name!r} must have a name that begins with {self.name + '_'!r}")
            for term, _ in axis.weights:
                term_factors(term, inputs)
        names = check_names(f"axes of {self.name}", [axis.name for axis in self.axes])
        if set(names) & set(inputs):
            raise InputError(f"{self.name} has an input among its own axes; inputs must be other characteristics")
        get_characteristics(inputs)
        check_facts(f"training of {self.name}", self.training)

    def __hash__(self) -> int:
        return hash((self.name, self.inputs, self.axes))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return tuple(axis.name for axis in self.axes)

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of names, scales and weights."""
        return hashlib.sha256(json.dumps(_content(self)).encode("utf-8")).hexdigest()

    @property
    def characteristics(self) -> tuple[Characteristic, ...]:
        """The axes as ordinary characteristics; their unit is a standard deviation over the policies learned from."""
        return tuple(
            Characteristic(axis.name, "sd", axis.meaning, _AxisFunction(self.inputs, axis)) for axis in self.axes
        )

    def estimate(self, values: Floats) -> Floats:
        """Return all axes, shape (..., C), from values of the inputs in their order, shape (..., I)."""
        known = _standardised(self.inputs, values)
        return np.stack([_weighted(axis, known) for axis in self.axes], axis=-1)

    def to_plain(self) -> dict[str, Any]:
        """Return the set as texts, numbers, lists and mappings, with its digest."""
        return {**_content(self), "training": dict(self.training), "sha256": self.content_hash}

    @classmethod
    def from_plain(cls, plain: Any) -> "LearnedCharacteristics":
        """Return the set that :meth:`to_plain` wrote."""
        outer = _mapping("learned characteristics", plain, ("name", "inputs", "axes", "training", "sha256"))
        inputs, axes = (_list(key, outer[key]) for key in ("inputs", "axes"))
        inputs = [_mapping("an input", item, ("name", "mean", "scale")) for item in inputs]
        axes = [_mapping("an axis", item, ("name", "meaning", "intercept", "weights")) for item in axes]
        for axis in axes:
            if not isinstance(axis["weights"], dict):
                raise InputError(f"weights are {axis['weights']!r:.80}; they must be numbers by term")
        learned = cls(
            outer["name"],
            tuple(LearnedInput(**item) for item in inputs),
            tuple(LearnedAxis(**{**axis, "weights": tuple(axis["weights"].items())}) for axis in axes),
            outer["training"],
        )
        if learned.content_hash != outer["sha256"]:
            raise InputError(f"the weights of {learned.name} are not those that its sha256 belongs to")
        return learned


@dataclass(frozen=True)
class _AxisFunction:
    """The function of an axis; a value, so that an axis that is read twice is the same one."""

    inputs: tuple[LearnedInput, ...]
    axis: LearnedAxis

    def __call__(self, segment: Segment) -> Floats:
        values = measure(segment, get_characteristics([item.name for item in self.inputs]))
        known = _standardised(self.inputs, values)
        return _weighted(self.axis, known)


def check_set_name(name: Any) -> str:
    """Return the name of a set of learned characteristics."""
    if not isinstance(name, str) or not re.fullmatch(r"[a-z][a-z0-9_-]{0,39}", name):
        raise InputError(f"name is {name!r}; use up to 40 small letters, digits, _ and -, a letter first")
    return name


def register_learned(learned: LearnedCharacteristics) -> None:
    """Register learned characteristics under their names; registering equal ones again does nothing."""
    for characteristic in learned.characteristics:
        register_characteristic(characteristic)


def save_learned(learned: LearnedCharacteristics, path: str | os.PathLike[str]) -> Path:
    """Write learned characteristics as YAML; the file appears whole or not at all."""
    LEARNED_FORMAT.write(Path(path), learned.to_plain())
    return Path(path)


def load_learned(source: str | os.PathLike[str] | LearnedCharacteristics) -> LearnedCharacteristics:
    """Return learned characteristics from their file, or as they are, and register them."""
    if isinstance(source, LearnedCharacteristics):
        register_learned(source)
        return source
    if not isinstance(source, str | os.PathLike):
        raise InputError(f"learned characteristics {source!r:.80} must be the path of a file")
    fields = LEARNED_FORMAT.read(source)
    try:
        learned = LearnedCharacteristics.from_plain(fields)
        register_learned(learned)
    except InputError as error:
        raise type(error)(f"{source}: {error}") from None
    return learned


def term_factors(term: str, inputs: tuple[str, ...]) -> tuple[str, ...]:
    """Return the inputs that a term is the product of."""
    factors = tuple(term.split(TIMES))
    if len(factors) > MOST_FACTORS or not set(factors) <= set(inputs):
        raise InputError(
            f"term {term!r} must be a product of 1 to {MOST_FACTORS} of the inputs {', '.join(inputs)}, joined by '*'"
        )
    return factors


def _standardised(inputs: tuple[LearnedInput, ...], values: Floats) -> dict[str, Floats]:
    """Inputs by name on the scale on which they enter terms, from values of shape (..., I)."""
    return {
        item.name: np.clip((values[..., i] - item.mean) / item.scale, -BOUND, BOUND) for i, item in enumerate(inputs)
    }


def _weighted(axis: LearnedAxis, known: Mapping[str, Floats]) -> Floats:
    """Add up the terms of an axis."""
    total = np.full(np.shape(next(iter(known.values()))), axis.intercept)
    # Term by term: the result of a matrix product may depend on the other races of the batch in its last bit.
    for term, weight in axis.weights:
        product = np.full_like(total, weight)
        for factor in term.split(TIMES):
            product *= known[factor]
        total += product
    return total


def _content(learned: LearnedCharacteristics) -> dict[str, Any]:
    axes = [{**asdict(axis), "weights": dict(axis.weights)} for axis in learned.axes]
    return {"name": learned.name, "inputs": [asdict(item) for item in learned.inputs], "axes": axes}


def _mapping(what: str, value: Any, keys: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(value, dict) or set(value) != set(keys):
        raise InputError(f"{what} is {value!r:.80}; it must be a mapping of {', '.join(keys)}")
    return value


def _list(what: str, value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(f"{what} is {value!r:.80}; it must be a list")
    return value
