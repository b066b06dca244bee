"""Archives of policies: parameter vectors and their coordinates in the Policy Characteristic Space.

Metres and seconds share no scale, so distances are taken in normalised coordinates: 0 at the
archive's nadir point (the worst value on each axis) and 1 at its ideal point (the best).
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import (
    InputError,
    UnknownNameError,
    check_array,
    check_facts,
    check_names,
    check_text,
    check_whole,
)
from pcs_racing.base.typing import Floats, Indices
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.registry import get_planner, parse_policy

MAX_COORDINATE = 1e9
"""Max parameter or coordinate of an archive; sums of their squares stay finite."""


@dataclass(frozen=True, eq=False)
class PolicyArchive:
    """Policies of one planner and their coordinates in Policy Characteristic Space.

    Section IV of the paper describes the space.
    """

    name: str
    planner: str  #: Name of the planner of all policies.
    #: Names of the columns of ``parameters``, which are parameters of the planner. Missing
    #: parameters have the values of ``settings["start"]``, a policy's text, or the planner's
    #: defaults (:meth:`complete`).
    parameter_names: tuple[str, ...]
    parameters: Floats  #: shape (K, P)
    #: Names of the axes (:func:`pcs_racing.game.characteristics.get_characteristics`); a larger
    #: value is more on all of them.
    characteristics: tuple[str, ...]
    #: shape (K, G): Coordinates of the policies, in the characteristics' units. They come from
    #: races that were not used to choose the policies, since the best of many noisy values is
    #: biased upwards.
    coordinates: Floats
    #: shape (G,): Point at 1 on each normalised axis; by default the max coordinates.
    ideal: Floats = None  # type: ignore[assignment]
    #: shape (G,): Point at 0 on each normalised axis; by default the min coordinates.
    nadir: Floats = None  # type: ignore[assignment]
    #: shape (E, P): Parameters of all policies evaluated during the synthesis.
    explored_parameters: Floats = None  # type: ignore[assignment]
    #: shape (E, G): Coordinates of all policies evaluated during the synthesis.
    explored_coordinates: Floats = None  # type: ignore[assignment]
    #: Settings of the synthesis: texts and numbers by name. ``segment_seconds`` is the length of a
    #: race segment; the coordinates are means over segments.
    settings: Mapping[str, str | int | float | bool] = field(default_factory=dict)
    rules: str = "paper"  #: Name of the rules of the measured races.
    spread: Floats | None = None  #: shape (K, G): Standard errors of the coordinates.
    #: shape (K,): Share of the measured races ended by a crash of the policy's own fault, 0 to 1.
    own_crash: Floats | None = None
    #: shape (E,): Same share for all policies evaluated during the synthesis.
    explored_own_crash: Floats | None = None

    def __post_init__(self) -> None:
        for key in ("name", "planner", "rules"):
            check_text(f"an archive's {key}", getattr(self, key))
        where = f"archive {self.name!r}"
        for key in ("parameter_names", "characteristics"):
            object.__setattr__(self, key, check_names(f"{where}: {key}", getattr(self, key)))
        get_characteristics(self.characteristics)
        object.__setattr__(self, "settings", check_facts(f"{where}: settings", self.settings))
        theta, axes = len(self.parameter_names), len(self.characteristics)
        self._set_array("parameters", (None, theta))
        if len(self) == 0:
            raise InputError(f"{where} holds no policy; it must hold at least one")
        self._set_array("coordinates", (len(self), axes))
        # By default each axis is scaled to the archive's range.
        self._set_array("ideal", (axes,), self.coordinates.max(axis=0))
        self._set_array("nadir", (axes,), self.coordinates.min(axis=0))
        self._set_array("explored_parameters", (None, theta), np.zeros((0, theta)))
        explored = len(self.explored_parameters)
        self._set_array("explored_coordinates", (explored, axes), np.zeros((0, axes)))
        for key, shape in (
            ("spread", (len(self), axes)),
            ("own_crash", (len(self),)),
            ("explored_own_crash", (explored,)),
        ):
            if getattr(self, key) is not None:
                self._set_array(key, shape, minimum=0.0)
        for axis, low, high in zip(self.characteristics, self.nadir, self.ideal, strict=True):
            if not low < high:
                raise InputError(
                    f"{where}: {axis} reaches from {low:g} (nadir) to {high:g} (ideal); the ideal"
                    " must be the larger"
                )

    def _set_array(
        self,
        key: str,
        shape: tuple[int | None, ...],
        default: Floats | None = None,
        minimum: float | None = None,
    ) -> None:
        given: Any = default if getattr(self, key) is None else getattr(self, key)
        lowest = -MAX_COORDINATE if minimum is None else minimum
        array = check_array(
            f"archive {self.name!r}: {key}", given, shape, minimum=lowest, maximum=MAX_COORDINATE
        )
        array.setflags(write=False)
        object.__setattr__(self, key, array)

    def __len__(self) -> int:
        return len(self.parameters)

    def __repr__(self) -> str:
        """Show the number of policies, the axes with their correlation, and the rules."""
        axes = ", ".join(self.characteristics)
        if len(self.characteristics) > 1:
            together = ", ".join(f"{value:+.2f}" for value in self.correlations.values())
            axes += f" (correlation {together})"
        return (
            f"<PolicyArchive {self.name!r}: {len(self)} {self.planner} policies, {axes}, rules"
            f" {self.rules!r}>"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by value (a read-only mapping can't be pickled)."""
        values = {**self.__dict__, "settings": dict(self.settings)}
        return PolicyArchive, tuple(values[key] for key in self.__dataclass_fields__)

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the policies and their coordinates; the name is not part of it."""
        digest = hashlib.sha256()
        # With lengths before texts and shapes before arrays, no two archives have the same bytes.
        for text in (self.planner, *self.parameter_names, *self.characteristics):
            digest.update(f"{len(text)} {text};".encode())
        for key in ("parameters", "coordinates", "ideal", "nadir"):
            array = getattr(self, key)
            digest.update(f"{key} {array.shape};".encode() + array.astype("<f8").tobytes())
        return digest.hexdigest()

    # Coordinates

    @property
    def normalised(self) -> Floats:
        """Normalised coordinates of the policies, shape (K, G): 0 at the nadir, 1 at the ideal
        point.
        """
        return self.normalise(self.coordinates)

    @property
    def correlations(self) -> dict[tuple[str, str], float]:
        """Correlation of the coordinates of each pair of axes over the policies, -1 to 1.

        At -1 or 1 the two axes are equivalent, and half of the moves duplicate the other half. It
        is NaN if all policies have the same value on an axis.
        """
        # Written out: numpy's corrcoef warns where an axis has no spread, and may leave -1 to 1 by
        # a bit.
        pairs = list(combinations(range(len(self.characteristics)), 2))
        away = self.coordinates - self.coordinates.mean(axis=0)
        extent = np.sqrt((away**2).sum(axis=0))
        with np.errstate(invalid="ignore"):
            values = [
                float(np.clip(away[:, i] @ away[:, j] / (extent[i] * extent[j]), -1.0, 1.0))
                for i, j in pairs
            ]
        return {
            (self.characteristics[i], self.characteristics[j]): value
            for (i, j), value in zip(pairs, values, strict=True)
        }

    def normalise(self, coordinates: ArrayLike) -> Floats:
        """Return normalised coordinates of points in the characteristics' units, shape (..., G)."""
        return (np.asarray(coordinates, np.float64) - self.nadir) / (self.ideal - self.nadir)

    def nearest(self, points: ArrayLike) -> Indices:
        """Return the index of the policy nearest to each normalised point.

        The shape is (...) for points (..., G). Distances are Euclidean; among policies at the same
        distance the lowest index is taken.
        """
        points = np.asarray(points, np.float64)
        axes = len(self.characteristics)
        if points.ndim == 0 or points.shape[-1] != axes:
            raise InputError(
                f"points have shape {points.shape}; archive {self.name!r} needs (..., {axes})"
            )
        if not np.isfinite(points).all():
            raise InputError("points hold NaN or infinity; they must be finite")
        flat = points.reshape(-1, axes)
        nearest = np.empty(len(flat), np.int64)
        for first in range(0, len(flat), 4096):  # bounded memory for any number of points
            # Differences, not a matrix product: equal distances stay equal, and the lowest index
            # wins everywhere.
            offsets = flat[first : first + 4096, None, :] - self.normalised
            nearest[first : first + 4096] = np.argmin(np.sum(offsets * offsets, axis=-1), axis=1)
        return nearest.reshape(points.shape[:-1])

    # Policies

    def family(self) -> Planner:
        """Return the planner of the archive's policies; raise an error if it can't drive them."""
        planner = get_planner(self.planner)
        unknown = [name for name in self.parameter_names if name not in planner.parameter_names]
        if unknown:
            raise InputError(
                f"archive {self.name!r} holds parameters {', '.join(self.parameter_names)}; planner"
                f" {self.planner!r} has {', '.join(planner.parameter_names)}"
            )
        for i, theta in enumerate(self.complete(self.parameters)):
            Policy(planner, theta, f"{self.name}[{i}]")
        return planner

    def complete(self, parameters: ArrayLike) -> Floats:
        """Return the planner's parameter vectors for rows of the archive's parameters, (K, P).

        Parameters missing in the archive have the values of the policy ``settings["start"]``, if
        there is one, or the planner's defaults.
        """
        start = self.settings.get("start", "none")
        planner = get_planner(self.planner)
        policy = planner.policy() if start == "none" else parse_policy(str(start))
        if policy.planner.name != self.planner:
            raise InputError(
                f"archive {self.name!r}: start is {start!r}; it must be a policy of planner"
                f" {self.planner!r}"
            )
        return planner.complete(self.parameter_names, parameters, policy.parameters)

    def policy(self, index: int) -> Policy:
        """Return one of the policies, named after the archive and its index."""
        return self._policy("policy", self.parameters, index, self.name)

    def explored_policy(self, index: int) -> Policy:
        """Return one of the policies evaluated during the synthesis."""
        where = f"{self.name}:explored"
        return self._policy("explored policy", self.explored_parameters, index, where)

    def _policy(self, noun: str, parameters: Floats, index: int, where: str) -> Policy:
        at = check_whole(f"{noun} index", index, 0, len(parameters) - 1)
        theta = self.complete(parameters[[at]])[0]
        return Policy(get_planner(self.planner), theta, f"{where}[{at}]")

    def select(self, by: str = "middle") -> int:
        """Return the index of the policy with the max of a characteristic.

        With ``"middle"`` it is the policy in the middle of the archive.
        """
        if by == "middle":
            return int(self.nearest(np.median(self.normalised, axis=0)))
        return int(np.argmax(self.coordinates[:, self._axis(by)]))

    def project(self, characteristics: Sequence[str]) -> "PolicyArchive":
        """Return the archive with some of its axes only, in the given order."""
        axes = [self._axis(name) for name in characteristics]
        values: dict[str, Any] = {key: getattr(self, key) for key in self.__dataclass_fields__}
        values["characteristics"] = tuple(characteristics)
        for key in ("coordinates", "ideal", "nadir", "explored_coordinates", "spread"):
            values[key] = None if values[key] is None else values[key][..., axes]
        return PolicyArchive(**values)

    def _axis(self, name: str) -> int:
        if name not in self.characteristics:
            raise UnknownNameError(
                f"archive {self.name!r} has no characteristic {name!r}; it has"
                f" {', '.join(self.characteristics)}"
            )
        return self.characteristics.index(name)
