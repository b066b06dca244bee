"""A recorded race as a value: what was driven, planned and considered, and what happened on the way."""

from dataclasses import dataclass

import numpy as np

from pcs_racing.base.checks import check_number, check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.race.state import MOST_CARS

_LARGEST = 1e9
_LONGEST_TEXT = 500


@dataclass(frozen=True)
class ReplayEvent:
    """Something that happened at one moment of a race."""

    time: float  #: Seconds since the start.
    car: int  #: Whose event it is.
    kind: str  #: ``"crash"``, ``"overtake"`` and ``"move"`` have signs of their own; any other word is allowed.
    text: str = ""  #: What to tell the viewer, such as ``"aggressiveness +"``.


@dataclass(frozen=True, eq=False)
class Replay:
    """A race as it was driven: nothing but values, checked and copied when it is made; the arrays are read-only."""

    title: str  #: Shown in the page's header, as is the track's name.
    track_name: str
    car_names: tuple[str, ...]  #: Names of the 1 to 8 drivers, one for each of C cars.
    #: shape (T, C, 7): States x, y, delta, v, psi, psi_dot, beta of the cars every ``frame_dt`` (m, rad, s).
    cars: np.ndarray
    progress: np.ndarray  #: shape (T, C): Cumulative arc length driven along the line in m; its difference is the lead.
    #: shape (S, 4): Wall segments x0, y0, x1, y1 in m. Where they close to loops, the track is filled between them.
    walls: np.ndarray
    line: np.ndarray  #: shape (N, 2): The closed race line in m.
    line_speed: np.ndarray | None = None  #: shape (N,): Speed along it in m/s; colours it.
    frame_dt: float = 0.05  #: Seconds between two rows of ``cars``.
    #: shape (T, C): Smallest instantaneous time to collision of each car in s; infinite is allowed (stored as 60 s).
    ittc: np.ndarray | None = None
    plan_dt: float = 0.1  #: Seconds between two plans; plan k is made at ``k * plan_dt``.
    #: shape (K, C, P, 4): The plan each car follows: points x, y (m), speed (m/s) and time (s, from the moment of the
    #: plan); rows after its last point are NaN.
    paths: np.ndarray | None = None
    #: shape (K, C, Q, P', 2): Points x, y of every path that was considered; rows after its last point are NaN.
    candidates: np.ndarray | None = None
    #: shape (K, C, Q): Their costs; infinite for a rejected one. Goes with ``candidates``.
    costs: np.ndarray | None = None
    events: tuple[ReplayEvent, ...] = ()  #: In any order; kept sorted by time.
    outcome: str = ""  #: How it ended, in words.
    #: shape (C, 2): Half length and half width of each car in m; F1TENTH's if left out.
    half_sizes: np.ndarray | tuple[tuple[float, float], ...] | None = None

    def __post_init__(self) -> None:
        """Copy and check everything once, so that nothing else has to."""
        for name in ("title", "track_name", "outcome"):
            _check_text(getattr(self, name), name)
        if not isinstance(self.car_names, tuple | list) or not 1 <= len(self.car_names) <= MOST_CARS:
            raise InputError(f"car_names must be 1 to {MOST_CARS} names, got {self.car_names!r:.80}")
        count = len(self.car_names)
        for name in self.car_names:
            _check_text(name, "car_names")
        self._set("car_names", tuple(self.car_names))
        for name in ("frame_dt", "plan_dt"):
            self._set(name, float(check_number(name, getattr(self, name), 1e-4, 60.0)))

        self._set_array("cars", ("T", count, 7), {})
        if len(self.cars) == 0:
            raise InputError("cars must hold at least one moment, got none")
        sizes = {"T": len(self.cars)}
        self._set_array("progress", ("T", count), sizes)
        self._set_array("walls", ("S", 4), sizes)
        self._set_array("line", ("N", 2), sizes)
        if len(self.line) < 3:
            raise InputError(f"line must have at least three points, got shape {self.line.shape}")
        self._set_array("line_speed", ("N",), sizes)
        if self.half_sizes is None:
            self._set("half_sizes", ((0.29, 0.155),) * count)
        self._set_array("half_sizes", (count, 2), sizes)
        if not np.all((np.asarray(self.half_sizes) > 0.0) & (np.asarray(self.half_sizes) < 100.0)):
            raise InputError("half_sizes must be positive lengths in m")
        self._set_array("ittc", ("T", count), sizes, allow="inf")
        self._set_array("paths", ("K", count, "P", 4), sizes, allow="nan")
        self._set_array("candidates", ("K", count, "Q", "P'", 2), sizes, allow="nan")
        self._set_array("costs", ("K", count, "Q"), sizes, allow="inf")
        if (self.candidates is None) != (self.costs is None):
            raise InputError("candidates and costs go together: give both or neither")
        self._set("events", _checked_events(self.events, count))

    @property
    def duration(self) -> float:
        """Time of the last frame in s."""
        return (len(self.cars) - 1) * self.frame_dt

    @property
    def lead(self) -> np.ndarray:
        """How far car 0 is ahead of the first of the others in m, shape (T,); alone 0."""
        rivals = self.progress[:, 1:] if len(self.car_names) > 1 else self.progress
        return np.asarray(self.progress[:, 0] - rivals.max(axis=1))

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _set_array(self, name: str, shape: tuple[int | str, ...], sizes: dict[str, int], allow: str = "") -> None:
        """Replace a field by a read-only copy of the expected shape; letters take their sizes from ``sizes``."""
        if getattr(self, name) is None:
            return
        try:
            array = np.array(getattr(self, name), dtype=np.float64, order="C")
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{name} must be an array of numbers") from None
        # The first array with a letter decides its size; all later ones must agree.
        wanted = tuple(sizes.get(size, size) if isinstance(size, str) else size for size in shape)
        if array.ndim != len(wanted) or any(
            isinstance(w, int) and w != n for w, n in zip(wanted, array.shape, strict=True)
        ):
            raise InputError(f"{name} must have shape ({', '.join(map(str, wanted))}), got {array.shape}")
        sizes.update({letter: n for letter, n in zip(shape, array.shape, strict=True) if isinstance(letter, str)})
        known = array
        if allow == "nan":
            missing = np.asarray(np.isnan(array).any(axis=-1))
            if np.any(missing[..., :-1] & ~missing[..., 1:]):
                raise InputError(f"{name} may be NaN only after the last point of a path")
            known = array[~missing]
        elif allow == "inf":
            known = array[array != np.inf]
        if not np.all(np.abs(known) <= _LARGEST):
            raise InputError(f"{name} must be finite and at most {_LARGEST:.0e} in size")
        array.setflags(write=False)
        self._set(name, array)


def _check_text(value: object, name: str) -> None:
    if not isinstance(value, str) or len(value) > _LONGEST_TEXT:
        raise InputError(f"{name} must be text of at most {_LONGEST_TEXT} characters, got {value!r:.80}")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise InputError(f"{name} must be text that UTF-8 can hold, got {value!a:.80}") from None


def _checked_events(events: object, cars: int) -> tuple[ReplayEvent, ...]:
    if not isinstance(events, tuple | list) or not all(isinstance(event, ReplayEvent) for event in events):
        raise InputError("events must be a tuple of ReplayEvent")
    for event in events:
        check_number("the time of an event", event.time, 0.0, 1e6)
        check_whole("the car of an event", event.car, 0, cars - 1)
        _check_text(event.kind, "the kind of an event")
        _check_text(event.text, "the text of an event")
    return tuple(sorted(events, key=lambda event: event.time))
