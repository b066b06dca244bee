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
| normal, cut at 5 deviations and the field's range | ``{"normal": [mean, standard deviation]}`` |
| listed values, equally likely | ``{"choice": [...]}`` |

Fields with multiples (delays) are drawn in multiples. A drawn mass changes the yaw inertia in the
same proportion, unless the inertia is drawn, too. Draws follow the order of the fields: first the
draws for all cars, then the draws of car 0, of car 1, and so on.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any, Literal, get_args, get_origin

import numpy as np
from annotated_types import Interval, MultipleOf

from pcs_racing.base.errors import ConfigError, did_you_mean, is_number
from pcs_racing.base.settings import Option, number_range, options_of, read_settings
from pcs_racing.car.vehicle import RULES_NOISE, VehicleParams
from pcs_racing.race.state import MAX_CARS

CHOICE, LOG_UNIFORM, NORMAL, UNIFORM = "choice", "log_uniform", "normal", "uniform"
ALL, EACH = "all cars", "each"
CARS = tuple(f"car_{car}" for car in range(MAX_CARS))
SMALLEST = 1e-6  # min of a draw with a uniform logarithm
CUT = 5.0  # standard deviations from the mean to the ends of a normal draw
FLAT = 1e3  # range of the field; a normal draw with a larger deviation is uniform


def _limits(option: Option) -> Any:
    """Return the min and max of a field that is a number, or None."""
    ends = ((note.ge, note.le) for note in option.notes if isinstance(note, Interval))
    return next((pair for pair in ends if None not in pair), None)


def _step(option: Option) -> float:
    """Return the step of a field with multiples, or 0."""
    steps: Any = (note.multiple_of for note in option.notes if isinstance(note, MultipleOf))
    return float(next(steps, option.kind is int))


PARAMETERS: dict[str, Option] = {
    name: option
    for name, option in options_of(VehicleParams).items()
    if _limits(option) or option.kind is bool or get_origin(option.kind) is Literal
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
        """Min and max value; both are multiples if the field has multiples.

        None counts only if it is the only choice.
        """
        option = PARAMETERS[self.name]
        values = [value for value in self.values if value is not None] or [None]
        low, high = min(values), max(values)
        if self.kind == NORMAL:
            mean, far = self.values[0], CUT * self.values[1]
            low, high = max(_limits(option)[0], mean - far), min(_limits(option)[1], mean + far)
        if step := _step(option):
            # Multiples of 0.02 s are rarely exact in floating point; 1e-9 is a tolerance.
            first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
            if self.kind == NORMAL:  # rounded to the nearest multiple, also beyond the cut
                first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
            low, high = round(first * step, 12), round(last * step, 12)
        return low, high

    def value(self, generator: np.random.Generator) -> Any:
        """Draw a value."""
        if self.kind == CHOICE:
            return self.values[generator.integers(len(self.values))]
        option, (low, high) = PARAMETERS[self.name], self.ends
        step = _step(option)
        if step and self.kind == UNIFORM:
            value = low + step * int(generator.integers(round((high - low) / step) + 1))
        else:
            value = min(max(self._quantile(generator.random(), low, high), low), high)
        return option.kind(round(round(value / step) * step, 12) if step else value)

    def _quantile(self, share: float, low: float, high: float) -> float:
        """Return the value that a share of the distribution between two ends is below."""
        if self.kind == UNIFORM:
            return low + (high - low) * share
        if self.kind == LOG_UNIFORM:
            return low * (high / low) ** share
        mean, deviation = self.values
        if deviation == 0.0 or low == high:
            return float(mean)
        normal = NormalDist(mean, min(deviation, FLAT * (high - low)))
        below, up_to = normal.cdf(low), normal.cdf(high)
        return normal.inv_cdf(min(max(below + (up_to - below) * share, 1e-300), 1.0 - 1e-16))

    def plain(self) -> Any:
        """Return the draw as it is spelled."""
        return list(self.values) if self.kind == UNIFORM else {self.kind: list(self.values)}


@dataclass(frozen=True)
class Randomization:
    """Draws of each episode; :func:`load_randomization` makes them from their spelling."""

    #: Draws for "all cars", of "each" car, and of "car_0" to "car_7", in the order of the fields.
    groups: tuple[tuple[str, tuple[Draw, ...]], ...] = ()

    @property
    def draws(self) -> tuple[Draw, ...]:
        """All draws."""
        return tuple(draw for _, draws in self.groups for draw in draws)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all drawn values, in the order of the fields."""
        drawn = {draw.name for draw in self.draws}
        return tuple(name for name in PARAMETERS if name in drawn)

    @property
    def own(self) -> tuple[str, ...]:
        """Names of the values drawn per car."""
        shared = {draw.name for draw in dict(self.groups).get(ALL, ())}
        return tuple(name for name in self.names if name not in shared)

    @property
    def max_delays(self) -> VehicleParams:
        """Car with the max of all drawn delays."""
        delays: dict[str, Any] = {}
        for draw in self.draws:
            if draw.name.endswith("_delay"):
                delays[draw.name] = max(delays.get(draw.name, 0.0), draw.ends[1])
        return VehicleParams(**delays)

    def check_cars(self, cars: int) -> None:
        """Refuse draws of a car that a race of ``cars`` cars does not have."""
        for group, _ in self.groups:
            if group in CARS[cars:]:
                there = "the only car is" if cars == 1 else "the cars are"
                raise ConfigError(f"randomize draws for {group}; {there} {', '.join(CARS[:cars])}")

    def draw(self, generator: np.random.Generator, cars: int = 2) -> list[dict[str, Any]]:
        """Draw the values of an episode: a mapping of names to values for each car."""
        groups, values = dict(self.groups), []
        shared = {draw.name: draw.value(generator) for draw in groups.get(ALL, ())}
        for car in CARS[:cars]:
            own = {draw.name: draw for draw in (*groups.get(EACH, ()), *groups.get(car, ()))}
            drawn = {name: own[name].value(generator) for name in PARAMETERS if name in own}
            values.append(shared | drawn)
        return values

    def plain(self) -> dict[str, Any]:
        """Return the draws as they are spelled."""
        plain = {group: {one.name: one.plain() for one in draws} for group, draws in self.groups}
        return plain.pop(ALL, {}) | plain


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


def cars_at_ends(
    randomization: Randomization, vehicles: Sequence[VehicleParams], *names: str
) -> tuple[list[VehicleParams], list[VehicleParams]]:
    """Return the cars with the min, and the cars with the max, of all draws, or of some fields."""
    groups = dict(randomization.groups)
    ends: tuple[list[VehicleParams], list[VehicleParams]] = [], []
    for car, vehicle in zip(CARS, vehicles, strict=False):
        draws = [draw for group in (ALL, EACH, car) for draw in groups.get(group, ())]
        for end, cars in enumerate(ends):
            drawn = {
                draw.name: draw.ends[end] for draw in draws if draw.name in (names or PARAMETERS)
            }
            cars.append(with_values(vehicle, drawn))
    return ends


def labels(name: str) -> dict[int, str]:
    """Return the names of a field by their numbers; empty for numbers."""
    kind = PARAMETERS[name].kind
    return dict(enumerate(get_args(kind))) if get_origin(kind) is Literal else {}


def as_number(name: str, value: Any) -> float:
    """Return a value of a field as a number: the index of a name, -1 for the rules' noise."""
    if isinstance(value, str):
        return float(get_args(PARAMETERS[name].kind).index(value))
    return RULES_NOISE if value is None else float(value)


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
    values = read_settings(source)
    try:
        return _read(values)
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from None


def _read(given: Mapping[Any, Any]) -> Randomization:
    rest = {name: value for name, value in given.items() if name not in (EACH, *CARS)}
    found: dict[str, dict[str, Draw]] = {}
    for group in (ALL, EACH, *CARS):
        found[group] = _read_group(group, rest if group == ALL else given.get(group, {}))
        for other in {ALL, EACH} & found.keys() - {group}:
            for name in found[other].keys() & found[group].keys():
                raise ConfigError(f"{name} is drawn for {other} and for {group}; draw it once")
    groups = ((group, tuple(draws.values())) for group, draws in found.items() if draws)
    return Randomization(tuple(groups))


def _read_group(group: str, given: Any) -> dict[str, Draw]:
    """Return the draws of all or some cars by name."""
    if not isinstance(given, Mapping):
        raise ConfigError(
            f"{group} is {given!r:.80}; it must be a mapping, such as {{'mu': [0.7, 1.1]}}"
        )
    for name in given:
        if name not in PARAMETERS:
            hint = VehicleParams.other_names.get(name)
            near = f" (did you mean {hint!r}?)" if hint else did_you_mean(name, PARAMETERS)
            raise ConfigError(
                f"randomize holds {name!r}; known are {', '.join(PARAMETERS)}, {EACH} and"
                f" {CARS[0]} to {CARS[-1]}{near}"
            )
    return {name: _read_draw(name, given[name]) for name in PARAMETERS if name in given}


def _read_draw(name: str, given: Any) -> Draw:
    limits = _limits(PARAMETERS[name])
    kind: Any = UNIFORM
    values = given
    if isinstance(given, Mapping):
        kind, values = next(iter(given.items())) if len(given) == 1 else ("", None)
    if kind not in ((UNIFORM, LOG_UNIFORM, NORMAL, CHOICE) if limits else (CHOICE,)):
        ranges = "[low, high], or one of log_uniform, normal and choice" if limits else "choice"
        raise ConfigError(f"{name} is {given!r:.80}; it must be {ranges} with a list of values")
    read = {CHOICE: _read_choice, NORMAL: _read_normal}.get(kind, _read_range)
    draw = Draw(name, kind, read(name, values, kind))
    if kind != CHOICE and draw.ends[0] > draw.ends[1]:
        step = _step(PARAMETERS[name])
        raise ConfigError(f"{name} is {given!r}; there is no multiple of {step:g} in it")
    return draw


def _read_range(name: str, values: Any, kind: str) -> tuple[Any, ...]:
    low, high = _limits(PARAMETERS[name])
    ends = number_range(max(low, SMALLEST) if kind == LOG_UNIFORM else low, high)
    return tuple(ends.function(name, values))


def _read_normal(name: str, values: Any, _kind: str) -> tuple[Any, ...]:
    low, high = _limits(PARAMETERS[name])
    fine = isinstance(values, list | tuple) and len(values) == 2 and all(map(is_number, values))
    if not fine or not low <= values[0] <= high or not 0.0 <= values[1] <= 1e308:
        raise ConfigError(
            f"{name} is normal of {values!r:.80}; it must be [mean, standard deviation] with a mean"
            f" from {low:g} to {high:g} and a deviation from 0 to 1e308"
        )
    return float(values[0]), float(values[1])


def _read_choice(name: str, values: Any, _kind: str) -> tuple[Any, ...]:
    option = PARAMETERS[name]
    if not isinstance(values, list | tuple) or not values:
        raise ConfigError(f"{name} is a choice of {values!r:.80}; it must be of a list of values")
    # An option whose default is None may be None.
    kept = (
        None if value is option.default is None else option.checked(name, value) for value in values
    )
    return tuple(float(one) if option.kind is float and one is not None else one for one in kept)
