"""Calibration of a circuit by driving: how fast it may be driven, and where two cars may start.

:mod:`pcs_racing.race.calibration` keeps the result.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.elementary import exponential
from pcs_racing.base.errors import InputError, say
from pcs_racing.base.seeds import race_seeds
from pcs_racing.car.vehicle import F1TENTH, PSI, V
from pcs_racing.planners.lattice import REFERENCE
from pcs_racing.race.config import DT, Rules
from pcs_racing.race.contacts import END
from pcs_racing.race.driving import BareField, advance, kernel_settings, pad_parameters
from pcs_racing.race.kernel import KernelSettings
from pcs_racing.race.start_grid import places_of
from pcs_racing.race.start_places import crashes_of_pairs, fit_places
from pcs_racing.race.state import empty_state
from pcs_racing.track.frenet import SPEED, X, Y
from pcs_racing.track.track import Calibration, Track

SCALES = tuple(np.round(np.arange(0.60, 1.801, 0.05), 2).tolist())
# the bends of the race line need the whole friction of the tyres: mu g = 10.3 m/s^2
FRICTION_SCALE = 1.43
HAZARD_WITHOUT_NOISE, WIDTH_WITHOUT_NOISE = 0.10, 0.30
HAZARD_WITH_NOISE, WIDTH_WITH_NOISE = 0.50, 0.40
CRASH_AIM = 0.08  # max share of races of two cars that crash without noise ...
ALLOWED_OF_PAIRS = 0.07  # ... and of the races that are counted, whose share errs by 0.005
PAIR_STEP, PAIR_STEPS = 0.05, 6  # step of the speed scales down where more crash, and max steps
# m; other distances across the track are tried in such steps up and down
SPACING_STEP, SPACING_STEPS = 0.1, 4
NARROWEST = {"side-by-side": 0.5, "staggered": 0.0, "rolling": 0.0}  # m between the cars' centres
SCAN_CARS, SCAN_SECONDS = 160, 40.0


@dataclass(frozen=True)
class CalibrationReport:
    """A calibration, and the hazard scan that its speed range was read off."""

    track: str  #: Name of the circuit.
    rules: str  #: Name of the rules.
    scales: tuple[float, ...]  #: Speed scales driven: up to the first whose hazard is too large.
    #: Probability that a car alone crashes within 40 s at each of them, made non-decreasing.
    hazard: tuple[float, ...]
    calibration: Calibration  #: The speed range and the start places.

    def table(self) -> str:
        """Return the scan as text, one line for each scale."""
        low, high = self.calibration.speed_range
        counts = (
            f"{len(places_of(stretches))} that favour the {side}"
            for side, stretches in self.calibration.start_places.items()
        )
        lines = [
            f"{self.track}, {self.rules}: speed range {low:.2f} to {high:.2f}",
            f"start places: {', '.join(counts)}; cars {self.calibration.start_spacing:g} m apart",
            "scale  own crash per 40 s",
        ]
        lines += [
            f"{s:5.2f}  {h:6.1%}  {'#' * round(40 * h)}"
            for s, h in zip(self.scales, self.hazard, strict=True)
        ]
        return "\n".join(lines)


def _scan_settings(rules: Rules, speed_range: tuple[float, float]) -> KernelSettings:
    """Settings for a count of crashes: a crash ends a race, under all rules."""
    return kernel_settings(rules, speed_range)._replace(contact=END, most_faults=0)


def hazard_scan(
    track: Track,
    rules: Rules,
    scales: Sequence[float] = SCALES,
    *,
    cars: int = 80,
    seconds: float = SCAN_SECONDS,
    seed: int = 0,
    threads: int | None = None,
    enough: float = 1.0,
) -> NDArray[np.float64]:
    """Probability that a car alone crashes within 40 s, at each of some ascending speed scales.

    Cars with the default lattice policy start on the race line at its speed, spread evenly around
    the circuit, and drive for some seconds; each race holds two of them, half a lap apart, so their
    number is even. The steering noise of the rules makes the hazard smooth. The scan ends after
    the first scale whose hazard is above ``enough``.
    """
    if cars < 2 or cars % 2:
        raise InputError(f"cars is {cars}; it must be an even number from 2")
    races = cars // 2
    theta = pad_parameters([REFERENCE.policy()], len(REFERENCE.parameters))
    theta = np.ascontiguousarray(np.broadcast_to(theta[:, None], (races, 2, theta.shape[1])))
    hazards: list[float] = []
    for scale in scales:
        settings = _scan_settings(rules, (scale, scale + 1e-6))._replace(
            end_tick=round(100.0 * seconds), ittc_horizon=0.0
        )
        state = empty_state(races, REFERENCE.memory_total)
        state.seed[:] = race_seeds(seed, races)
        for car in range(2):
            s = np.mod((np.arange(races) / races + car) * 0.5 * track.length, track.length)
            sample = (s / track.arrays.ds).astype(np.intp) % len(track.arrays.line)
            pose = track.to_cartesian(np.stack([s, np.zeros(races)], axis=-1))
            state.cars[:, car, X] = pose[:, 0]
            state.cars[:, car, Y] = pose[:, 1]
            state.cars[:, car, PSI] = np.mod(pose[:, 2], 2.0 * np.pi)
            state.cars[:, car, V] = scale * track.arrays.line[sample, SPEED]
            state.frenet[:, car, 0] = s
            state.progress[:, car] = 0.5 * car * track.length
        field = BareField(track, settings, (REFERENCE, REFERENCE), (F1TENTH, F1TENTH))
        advance(field, state, theta, settings.end_tick, threads=threads)
        # A race ends for both cars at the first crash, so count crashes per time driven rather than
        # per car.
        driven = 2.0 * DT * float(state.tick.sum())
        hazards.append(1.0 - float(exponential(-40.0 * float((state.crash == 1).sum()) / driven)))
        if hazards[-1] > enough:
            break
    return np.array(hazards)


def calibrate(
    track: Track, rules: Rules, *, cars: int = SCAN_CARS, seed: int = 0
) -> CalibrationReport:
    """Find the speed range of a circuit for a race configuration, and the places to start from.

    Pace 1 is the scale with crashes of 50 % of single cars in 40 s, and pace 0 lies 0.40 below.
    Without steering noise (rules ``paper``) the hazard is nearly a step: there pace 1 is the scale
    of 10 %, and pace 0 lies 0.30 below; both are lowered in steps of 0.05 until pairs of cars
    rarely crash, and a line says where that can't be met. No pace asks for more than the friction
    of the tyres: the vehicle model would give it, a road would not.

    Pairs of drivers get away from the start places (`pcs_racing.race.start_places`). Where none is
    left with the rules' distance across the track, the nearest distance that
    works is taken. A circuit that is too tight for these cars is an error.
    """
    noisy = rules.steering_noise > 0.0
    allowed = HAZARD_WITH_NOISE if noisy else HAZARD_WITHOUT_NOISE
    hazard = np.maximum.accumulate(hazard_scan(track, rules, cars=cars, seed=seed, enough=allowed))
    scales = np.array(SCALES[: len(hazard)])
    if hazard[0] > allowed:
        raise InputError(
            f"track {track.name!r}: at speed scale {scales[0]:.2f} a car alone crashes in"
            f" {hazard[0]:.0%} of 40 s; widen the track or lower steering_noise"
        )
    high = _highest(hazard, allowed)
    width = WIDTH_WITH_NOISE if noisy else WIDTH_WITHOUT_NOISE

    def settings_at(step: int) -> KernelSettings:
        top = round(float(high - step * PAIR_STEP), 2)
        return _scan_settings(rules, (round(float(high - step * PAIR_STEP - width), 2), top))

    fit = fit_places(track, rules, settings_at(0), _spacings(rules))
    step, crashes = 0, 0.0 if noisy else crashes_of_pairs(track, rules, settings_at(0), *fit)
    # Without noise, speeds that are safe for a car alone may not be safe in pairs: then the range
    # falls.
    while crashes > ALLOWED_OF_PAIRS and step < PAIR_STEPS:
        step += 1
        crashes = crashes_of_pairs(track, rules, settings_at(step), *fit)
    if step > 0:
        fit = fit_places(track, rules, settings_at(step), _spacings(rules))
    if crashes > CRASH_AIM:
        say(
            f"track {track.name!r}: two cars crash in {crashes:.0%} of the races of"
            f" {rules.name!r}, in more than the aim of {CRASH_AIM:.0%}, even with speeds lowered"
            f" by {step * PAIR_STEP:g} of the speed profile"
        )
    speed_range = (settings_at(step).speed_low, settings_at(step).speed_high)
    return CalibrationReport(
        track.name,
        rules.name,
        tuple(scales.tolist()),
        tuple(np.round(hazard, 4).tolist()),
        Calibration(speed_range, *fit),
    )


def find_speed_range(track: Track, rules: Rules, *, threads: int = 1) -> tuple[float, float]:
    """Return the speed range of a circuit for rules with noise, by short test drives: a second."""
    hazard = hazard_scan(
        track, rules, cars=40, seconds=20.0, enough=HAZARD_WITH_NOISE, threads=threads
    )
    high = _highest(np.maximum.accumulate(hazard), HAZARD_WITH_NOISE)
    return round(high - WIDTH_WITH_NOISE, 2), round(high, 2)


def find_places(
    track: Track, rules: Rules, known: Rules, speed_range: tuple[float, float]
) -> Calibration:
    """Find the start places for rules, with the speed range of the shipped rules."""
    settings = _scan_settings(known, speed_range)
    return Calibration(speed_range, *fit_places(track, rules, settings, [rules.start_spacing]))


def _spacings(rules: Rules) -> list[float]:
    """The usual distance across the track, then others, the nearest first, the wider one of two
    that are as near.
    """
    steps = sorted(range(-SPACING_STEPS, SPACING_STEPS + 1), key=lambda step: (abs(step), -step))
    spacings = [round(rules.start_spacing + step * SPACING_STEP, 3) for step in steps]
    return [
        spacing
        for spacing in spacings
        if spacing >= NARROWEST[rules.start] or spacing == rules.start_spacing
    ]


def _highest(hazard: NDArray[np.float64], allowed: float) -> float:
    """Highest allowed scale of a scan of `SCALES`, within the friction of the tyres."""
    scales = np.array(SCALES[: len(hazard)])
    return min(_crossing(scales, hazard, allowed), FRICTION_SCALE)


def _crossing(scales: NDArray[np.float64], hazard: NDArray[np.float64], level: float) -> float:
    """Scale where a hazard first exceeds a level; the last scale if it never does."""
    above = np.flatnonzero(hazard > level)
    if len(above) == 0:
        return float(scales[-1])
    i = int(above[0])
    share = (level - hazard[i - 1]) / (hazard[i] - hazard[i - 1])
    return float(scales[i - 1] + share * (scales[i] - scales[i - 1]))
