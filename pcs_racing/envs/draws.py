"""Random draws of the cars' parameters for each episode: domain randomization.

Any field of :class:`pcs_racing.car.vehicle.VehicleParams` that is a number, or one of several
names, can be drawn, by its name::

    {
        "mu": [0.7, 1.1],  # one draw for all cars
        "each": {"steer_lag": {"normal": [0.1, 0.03]}},  # an own draw for each car
        "car_1": {"speed_delay": {"choice": [0.0, 0.04]}},  # a draw for one car
    }

| distribution | spelling |
| --- | --- |
| uniform | ``[low, high]``, or a number |
| uniform logarithm | ``{"log_uniform": [low, high]}`` |
| normal, cut to the field's range | ``{"normal": [mean, standard deviation]}`` |
| listed values, equally likely | ``{"choice": [...]}`` |

Fields with multiples (delays) are drawn in multiples. A drawn mass changes the yaw inertia in the
same proportion, unless the inertia is drawn, too. Draws follow the order of the fields: first the
draws for all cars, then the draws of car 0, of car 1, and so on.
"""

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any, Literal, get_args, get_origin

import numpy as np
from annotated_types import Interval, MultipleOf

from pcs_racing.base.checks import did_you_mean, is_number
from pcs_racing.base.errors import ConfigError, UnknownNameError
from pcs_racing.base.settings import Option, number_range, options_of, read_settings
from pcs_racing.car.vehicle import RULES_NOISE, VehicleParams
from pcs_racing.race.state import MAX_CARS

CHOICE, LOG_UNIFORM, NORMAL, UNIFORM = "choice", "log_uniform", "normal", "uniform"
EACH = "each"
CARS = tuple(f"car_{car}" for car in range(MAX_CARS))


def _limits(option: Option) -> tuple[float, float]:
    """Return the range of a field that is a number; without a range (inf, -inf)."""
    limit = next((note for note in option.notes if isinstance(note, Interval)), None)
    ends: Any = (math.inf, -math.inf) if limit is None else (limit.ge, limit.le)
    return ends


def _step(option: Option) -> float:
    """Return the number of which a field is a multiple, or 0."""
    steps = (note.multiple_of for note in option.notes if isinstance(note, MultipleOf))
    first: Any = next(steps, 1.0 if option.kind is int else 0.0)
    return float(first)


def _can_be_drawn(option: Option) -> bool:
    is_bounded = option.kind in (int, float) and _limits(option)[0] < math.inf
    return is_bounded or option.kind is bool or get_origin(option.kind) is Literal


PARAMETERS: dict[str, Option] = {
    name: option for name, option in options_of(VehicleParams).items() if _can_be_drawn(option)
}
"""Fields that can be drawn, in the order of the draws."""


@dataclass(frozen=True)
class Draw:
    """Distribution of one parameter."""

    name: str  #: Field of :class:`pcs_racing.car.vehicle.VehicleParams`.
    kind: str  #: "uniform", "log_uniform", "normal" or "choice".
    values: tuple[Any, ...]  #: (low, high), (mean, standard deviation), or the choices.

    @property
    def ends(self) -> tuple[Any, Any]:
        """Min and max value."""
        if self.kind == CHOICE:
            return min(self.values), max(self.values)
        low, high = _limits(PARAMETERS[self.name]) if self.kind == NORMAL else self.values
        first, last, step = self._multiples(low, high)
        return (first * step, last * step) if step else (low, high)

    def value(self, generator: np.random.Generator) -> Any:
        """Draw a value."""
        if self.kind == CHOICE:
            return self.values[generator.integers(len(self.values))]
        low, high = _limits(PARAMETERS[self.name]) if self.kind == NORMAL else self.values
        first, last, step = self._multiples(low, high)
        if step and self.kind == UNIFORM:
            multiple = first + int(generator.integers(last - first + 1))
        else:
            value = min(max(self._spread(generator.random(), low, high), low), high)
            if not step:
                return float(value)
            multiple = min(max(round(value / step), first), last)
        return PARAMETERS[self.name].kind(round(multiple * step, 12))

    def _spread(self, share: float, low: float, high: float) -> float:
        """Return the value below which lies a share of the distribution between two ends."""
        if self.kind == UNIFORM:
            return low + (high - low) * share
        if self.kind == LOG_UNIFORM:
            return math.exp(math.log(low) + (math.log(high) - math.log(low)) * share)
        mean, deviation = self.values
        if deviation == 0.0:
            return float(mean)
        normal = NormalDist(mean, deviation)
        below, up_to = normal.cdf(low), normal.cdf(high)
        return normal.inv_cdf(min(max(below + (up_to - below) * share, 1e-300), 1.0 - 1e-16))

    def _multiples(self, low: float, high: float) -> tuple[int, int, float]:
        """Return the first and the last multiple between two ends, and the step, 0 without one."""
        step = _step(PARAMETERS[self.name])
        if step == 0.0:
            return 0, 0, 0.0
        # Multiples of 0.02 s are rarely exact in floating point; 1e-9 is a tolerance.
        return math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9), step

    def plain(self) -> Any:
        """Return the draw as it is spelled."""
        return list(self.values) if self.kind == UNIFORM else {self.kind: list(self.values)}


@dataclass(frozen=True)
class Randomization:
    """Draws of each episode; :func:`load_randomization` makes them from their spelling."""

    alike: tuple[Draw, ...] = ()  #: Draws for all cars.
    each: tuple[Draw, ...] = ()  #: Draws that each car makes.
    single: tuple[tuple[int, tuple[Draw, ...]], ...] = ()  #: Draws of single cars, by number.

    @property
    def own(self) -> tuple[str, ...]:
        """Names of the values drawn per car, in the order of the fields."""
        return _names([*self.each, *(draw for _, draws in self.single for draw in draws)])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all drawn values, in the order of the fields."""
        return _names(self._all)

    @property
    def _all(self) -> list[Draw]:
        return [*self.alike, *self.each, *(draw for _, draws in self.single for draw in draws)]

    @property
    def max_delays(self) -> VehicleParams:
        """Car with the max of all drawn delays."""
        delays: dict[str, Any] = {}
        for draw in self._all:
            if draw.name.endswith("_delay"):
                delays[draw.name] = max(delays.get(draw.name, 0.0), round(draw.ends[1], 12))
        return VehicleParams(**delays)

    def check_cars(self, cars: int) -> None:
        """Refuse draws of a car that a race of ``cars`` cars does not have."""
        for car, _ in self.single:
            if car >= cars:
                there = "the only car is" if cars == 1 else "the cars are"
                raise ConfigError(
                    f"randomize draws for car_{car}; {there} {', '.join(CARS[:cars])}"
                )

    def draw(self, generator: np.random.Generator, cars: int = 2) -> list[dict[str, Any]]:
        """Draw the values of an episode: those of each car by name."""
        alike, single = {draw.name: draw.value(generator) for draw in self.alike}, dict(self.single)
        values = []
        for car in range(cars):
            own = {draw.name: draw for draw in (*self.each, *single.get(car, ()))}
            drawn = {name: own[name].value(generator) for name in PARAMETERS if name in own}
            values.append(alike | drawn)
        return values

    def plain(self) -> dict[str, Any]:
        """Return the draws as they are spelled."""
        groups = [(EACH, self.each), *((CARS[car], draws) for car, draws in self.single)]
        return {draw.name: draw.plain() for draw in self.alike} | {
            name: {draw.name: draw.plain() for draw in draws} for name, draws in groups if draws
        }


def _names(draws: Iterable[Draw]) -> tuple[str, ...]:
    drawn = {draw.name for draw in draws}
    return tuple(name for name in PARAMETERS if name in drawn)


def with_values(vehicle: VehicleParams, drawn: Mapping[str, Any]) -> VehicleParams:
    """Return a car with drawn values."""
    changes = dict(drawn)
    if "m" in drawn and "inertia" not in drawn:
        changes["inertia"] = vehicle.inertia * (drawn["m"] / vehicle.m)
    return replace(vehicle, **changes)


def draw_vehicles(
    randomization: Randomization, vehicles: Sequence[VehicleParams], generator: np.random.Generator
) -> tuple[VehicleParams, ...]:
    """Return the cars of one race, with drawn values."""
    drawn = randomization.draw(generator, len(vehicles))
    return tuple(map(with_values, vehicles, drawn))


def as_number(name: str, value: Any) -> float:
    """Return a value of a field as a number: the index of a name, -1 for the rules' noise."""
    option = PARAMETERS[name]
    if get_origin(option.kind) is Literal:
        return float(get_args(option.kind).index(value))
    return RULES_NOISE if value is None else float(value)


def labels(name: str) -> dict[int, str]:
    """Return the names of a field by their numbers; empty for numbers."""
    kind = PARAMETERS[name].kind
    return dict(enumerate(get_args(kind))) if get_origin(kind) is Literal else {}


def load_randomization(
    source: "Randomization | Mapping[str, Any] | str | os.PathLike[str] | None",
) -> Randomization:
    """Return draws from a `Randomization`, a mapping or a YAML file; without draws for None.

    Examples
    --------
    >>> load_randomization({"mu": [0.8, 1.1], "each": {"steer_lag": [0.0, 0.1]}}).names
    ('mu', 'steer_lag')
    """
    if source is None or isinstance(source, Randomization):
        return source or Randomization()
    if isinstance(source, Mapping):
        return _read(source)
    if not isinstance(source, str | os.PathLike):
        raise ConfigError(
            f"randomization is {source!r:.80}; use a mapping or the path of a YAML file"
        )
    if not os.path.isfile(source):
        raise UnknownNameError(f"randomization {str(source)!r} is no YAML file")
    values = read_settings(source)
    try:
        return _read(values)
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from None


def _read(given: Mapping[Any, Any]) -> Randomization:
    groups = {name: value for name, value in given.items() if name in (EACH, *CARS)}
    alike = _read_draws({name: value for name, value in given.items() if name not in groups})
    each = _read_group(EACH, groups.pop(EACH, {}), [("all cars", alike)])
    others = [("all cars", alike), ("each car", each)]
    single = [
        (car, _read_group(name, groups.get(name, {}), others)) for car, name in enumerate(CARS)
    ]
    return Randomization(alike, each, tuple((car, draws) for car, draws in single if draws))


def _read_group(
    group: str, given: Any, others: Sequence[tuple[str, tuple[Draw, ...]]]
) -> tuple[Draw, ...]:
    """Return the draws of single cars, which no other group may have."""
    if not isinstance(given, Mapping):
        raise ConfigError(
            f"{group} is {given!r:.80}; it must be a mapping, such as {{'mu': [0.7, 1.1]}}"
        )
    draws = _read_draws(given)
    for draw in draws:
        for other, theirs in others:
            if draw.name in _names(theirs):
                raise ConfigError(f"{draw.name} is drawn for {other} and in {group}; draw it once")
    return draws


def _read_draws(given: Mapping[Any, Any]) -> tuple[Draw, ...]:
    for name in given:
        if name not in PARAMETERS:
            known = (*PARAMETERS, EACH, *CARS)
            hint = VehicleParams.other_names.get(name)
            near = f" (did you mean {hint!r}?)" if hint else did_you_mean(name, known)
            raise ConfigError(
                f"randomize holds {name!r}; known are {', '.join(PARAMETERS)}, {EACH} and"
                f" {CARS[0]} to {CARS[-1]}{near}"
            )
    return tuple(_read_draw(name, given[name]) for name in PARAMETERS if name in given)


def _read_draw(name: str, given: Any) -> Draw:
    option = PARAMETERS[name]
    kind: Any = UNIFORM
    values = given
    if isinstance(given, Mapping):
        kind, values = next(iter(given.items())) if len(given) == 1 else (None, None)
    numeric = option.kind in (int, float)
    read = _READERS.get(kind) if numeric or kind == CHOICE else None
    if read is None:
        ranges = "[low, high], or one of log_uniform, normal and choice" if numeric else "choice"
        raise ConfigError(f"{name} is {given!r:.80}; it must be {ranges} with a list of values")
    draw = Draw(name, kind, read(name, option, values))
    if numeric and kind != CHOICE and draw.ends[0] > draw.ends[1]:
        raise ConfigError(f"{name} is {given!r}; there is no multiple of {_step(option):g} in it")
    return draw


def _read_range(name: str, option: Option, values: Any) -> tuple[Any, ...]:
    ends: tuple[Any, ...] = number_range(*_limits(option)).function(name, values)
    return ends


def _read_logarithms(name: str, option: Option, values: Any) -> tuple[Any, ...]:
    low, high = _read_range(name, option, values)
    if low <= 0.0:
        raise ConfigError(f"{name} is log_uniform of {values!r}; it must begin above 0")
    return low, high


def _read_normal(name: str, option: Option, values: Any) -> tuple[Any, ...]:
    low, high = _limits(option)
    fine = isinstance(values, list | tuple) and len(values) == 2 and all(map(is_number, values))
    if not fine or not low <= values[0] <= high or values[1] < 0.0:
        raise ConfigError(
            f"{name} is normal of {values!r:.80}; it must be [mean, standard deviation] with a mean"
            f" from {low:g} to {high:g} and a deviation of at least 0"
        )
    return float(values[0]), float(values[1])


def _read_choice(name: str, option: Option, values: Any) -> tuple[Any, ...]:
    if not isinstance(values, list | tuple) or not values:
        raise ConfigError(f"{name} is a choice of {values!r:.80}; it must be of a list of values")
    convert = option.kind if option.kind in (int, float) else lambda value: value
    return tuple(convert(option.checked(name, value)) for value in values)


_READERS: Mapping[Any, Any] = {
    UNIFORM: _read_range,
    LOG_UNIFORM: _read_logarithms,
    NORMAL: _read_normal,
    CHOICE: _read_choice,
}
