"""Search for the parameters of a car that minimise the residuals of a log, with priors."""

from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.car.vehicle import COMMAND_PERIOD, MAX_DELAYED, VehicleParams
from pcs_racing.identification.logs import Floats
from pcs_racing.identification.windows import Residuals, rescaled

_NARROWED = 0.5  # max ratio of the standard deviations after and before the log
_MIN_LAG = 0.01  # s
_SHAPES = (1.3, 2.2)  # C of a curve that hardly falls behind its peak, and of a steep one


class Unknown(NamedTuple):
    """A parameter to find, with its prior around the start car."""

    low: float
    high: float
    sd: float  #: Standard deviation of the prior: of the logarithm, or of the value.
    logarithm: bool = True
    first: float = 0.0  #: Min value at which the search starts.
    step: float = 1e-4  #: Step of the finite differences.

    def to_free(self, value: float) -> float:
        """Return the coordinate of a value in the search."""
        value = float(np.clip(value, self.low, self.high))
        return float(np.log(value)) if self.logarithm else value

    def to_value(self, free: float) -> float:
        """Return the value of a coordinate."""
        return float(np.clip(np.exp(free) if self.logarithm else free, self.low, self.high))


UNKNOWNS = {
    "c_sf": Unknown(0.5, 100.0, 0.7),
    "c_sr": Unknown(0.5, 100.0, 0.7),
    "b_f": Unknown(0.5, 60.0, 0.7),
    "c_f": Unknown(0.5, 4.0, 0.4),
    "d_f": Unknown(0.05, 3.0, 0.5),
    "e_f": Unknown(-5.0, 1.0, 0.7, False),
    "b_r": Unknown(0.5, 60.0, 0.7),
    "c_r": Unknown(0.5, 4.0, 0.4),
    "d_r": Unknown(0.05, 3.0, 0.5),
    "e_r": Unknown(-5.0, 1.0, 0.7, False),
    # A lag far below the step of the simulator has no effect: a small step would not show it.
    "steer_lag": Unknown(0.0, 0.5, 0.2, False, 0.03, 0.003),
    "steer_rate_max": Unknown(0.2, 100.0, 0.7),
    "steer_max": Unknown(0.05, 1.5, 0.4),
    "speed_lag": Unknown(0.05, 5.0, 1.0),
    "a_max": Unknown(0.2, 100.0, 0.7),
}
"""Parameters that a log can show."""


class Fit(NamedTuple):
    """Result of a search over some parameters."""

    car: VehicleParams
    cost: float
    names: tuple[str, ...]
    deviations: Floats  #: shape (P,): Standard deviations in the coordinates of the search.
    narrowed: Floats  #: shape (P,): Standard deviations after the log per those before.
    residuals: Residuals

    def deviation(self, name: str) -> float:
        """Return the standard deviation of a parameter."""
        deviation = float(self.deviations[self.names.index(name)])
        return deviation * getattr(self.car, name) if UNKNOWNS[name].logarithm else deviation


def changed(car: VehicleParams, **changes: Any) -> VehicleParams:
    """Return a car with other values, without checks."""
    values = {field.name: getattr(car, field.name) for field in fields(car)}
    return VehicleParams.known(**{**values, **changes})


def search(
    residuals: Residuals,
    start: VehicleParams,
    prior: VehicleParams,
    names: Sequence[str],
    evaluations: int = 30,
) -> Fit:
    """Minimise the residuals over some parameters, from a start and around a prior."""
    from scipy.optimize import least_squares

    unknowns = [UNKNOWNS[name] for name in names]
    pairs = list(zip(names, unknowns, strict=True))
    center = np.array([unknown.to_free(getattr(prior, name)) for name, unknown in pairs])
    first = [unknown.to_free(max(getattr(start, name), unknown.first)) for name, unknown in pairs]
    low = np.array([unknown.to_free(unknown.low) for unknown in unknowns]) - 1e-9
    high = np.array([unknown.to_free(unknown.high) for unknown in unknowns]) + 1e-9
    spread = np.array([unknown.sd for unknown in unknowns])
    size = np.array([unknown.step for unknown in unknowns])

    def car_at(free: Iterable[float]) -> VehicleParams:
        values = {
            name: unknown.to_value(one) for (name, unknown), one in zip(pairs, free, strict=True)
        }
        return changed(start, **values)

    def values(free: Floats) -> Floats:
        rest = residuals.at(car_at(free))
        return np.concatenate([rest.ravel(), (free - center) / spread])

    def slopes(free: Floats) -> Floats:
        steps = np.where(free + size < high, size, -size)
        cars = [car_at(free), *(car_at(free + step) for step in np.diag(steps))]
        outer = residuals.slopes(cars, steps)
        return np.concatenate([outer.reshape(-1, len(names)), np.diag(1.0 / spread)])

    solved = least_squares(
        values,
        np.clip(first, low + 1e-6, high - 1e-6),
        slopes,
        (low, high),
        x_scale=spread,
        ftol=1e-5,
        xtol=1e-5,
        max_nfev=evaluations,
    )
    deviations, narrowed = _uncertainty(len(residuals.windows.rows), solved, spread)
    return Fit(car_at(solved.x), float(solved.cost), tuple(names), deviations, narrowed, residuals)


def _uncertainty(windows: int, solved: Any, spread: Floats) -> tuple[Floats, Floats]:
    """Return standard deviations with the windows as clusters, and Gauss-Newton's per prior."""
    inverse = np.linalg.inv(solved.jac.T @ solved.jac)
    number = len(spread)
    slopes = solved.jac[:-number].reshape(windows, -1, number)
    pulls = np.einsum("wmp,wm->wp", slopes, solved.fun[:-number].reshape(windows, -1))
    clustered = np.sqrt(np.diag(inverse @ (pulls.T @ pulls) @ inverse))
    plain = np.sqrt(np.diag(inverse))
    return np.maximum(clustered, plain), plain / spread


def settled(fit: Fit, prior: VehicleParams) -> Fit:
    """Return a fit with the standard deviations and speeds that an earlier fit implies."""
    return search(rescaled(fit.residuals, fit.car), fit.car, prior, fit.names)


def reshaped(fit: Fit, prior: VehicleParams) -> Fit:
    """Return the best fit of searches from other shapes of Pacejka's curve, axle by axle.

    The stiffness and the peak of a start are the values of the best fit so far.
    """
    for axle in ("_f", "_r"):
        for shape in _SHAPES:
            b, c = (getattr(fit.car, name + axle) for name in "bc")
            values = {"c": shape, "b": b * c / shape, "e": 0.0}
            car = changed(fit.car, **{name + axle: value for name, value in values.items()})
            tried = search(fit.residuals.like(), car, prior, fit.names, 8)
            fit = min(fit, tried, key=lambda one: one.cost)
    return fit


def with_delay(fit: Fit, prior: VehicleParams, name: str) -> Fit:
    """Return the best fit over the delays of an actuator, in steps of 0.02 s."""
    best, lag = fit, f"{name.partition('_')[0]}_lag"
    for way in (1, -1):
        number, failed, tried = round(getattr(best.car, name) / COMMAND_PERIOD), 0, best
        while failed < 2 and 0 <= number + way <= MAX_DELAYED:
            number += way
            old = tried.residuals
            made = old.like(model=replace(old.model, **{name: number}))
            # A later command needs a shorter lag.
            shorter = max(getattr(tried.car, lag) - way * COMMAND_PERIOD, _MIN_LAG)
            delayed = changed(tried.car, **{name: number * COMMAND_PERIOD, lag: shorter})
            tried = search(made, delayed, prior, best.names, 8)
            failed = 0 if tried.cost < best.cost else failed + 1
            best = tried if tried.cost < best.cost else best
    return best


def pruned(fit: Fit, prior: VehicleParams) -> Fit:
    """Return a fit of the parameters that the log shows; the others keep the prior's values."""
    while fit.names and fit.narrowed.max() > _NARROWED:
        worst = fit.names[int(fit.narrowed.argmax())]
        names = [name for name in fit.names if name != worst]
        kept = changed(fit.car, **{worst: getattr(prior, worst)})
        if not names:
            return fit._replace(car=kept, names=())
        fit = search(fit.residuals, kept, prior, names, 15)
    return fit
