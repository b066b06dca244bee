"""How fast is too fast on a circuit: the hazard of a car that drives alone, and the speed range that follows from
it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pcs_racing import vehicle as _vehicle
from pcs_racing.elementary import exponential
from pcs_racing.errors import InputError
from pcs_racing.frenet import SPEED
from pcs_racing.planner import Policy
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.race import RaceSetup, advance, pad_parameters, race_seeds
from pcs_racing.race_config import RaceConfig
from pcs_racing.race_kernel import DT
from pcs_racing.race_state import empty_state
from pcs_racing.track import Track

__all__ = ["CalibrationReport", "calibrate", "hazard_scan"]

SCALES = tuple(np.round(np.arange(0.60, 1.301, 0.05), 2).tolist())
HAZARD_WITHOUT_NOISE, BELOW_IT, WIDTH_WITHOUT_NOISE = 0.01, 0.09, 0.20
HAZARD_WITH_NOISE, WIDTH_WITH_NOISE = 0.45, 0.32


@dataclass(frozen=True)
class CalibrationReport:
    """A hazard scan and the speed range read off it.

    Attributes
    ----------
    track : str
        Name of the circuit.
    preset : str
        Name of the race configuration.
    scales : tuple of float
        Speed scales driven.
    hazard : tuple of float
        Probability that a car alone crashes within 40 s at each of them, made non-decreasing.
    speed_range : tuple of two floats
        Scales that stand for pace 0 and pace 1.
    """

    track: str
    preset: str
    scales: tuple[float, ...]
    hazard: tuple[float, ...]
    speed_range: tuple[float, float]

    def table(self) -> str:
        """Return the scan as text, one line for each scale."""
        low, high = self.speed_range
        lines = [f"{self.track}, {self.preset}: speed range {low:.2f} to {high:.2f}", "scale  own crash per 40 s"]
        lines += [f"{s:5.2f}  {h:6.1%}  {'#' * round(40 * h)}" for s, h in zip(self.scales, self.hazard, strict=True)]
        return "\n".join(lines)


def hazard_scan(
    track: Track,
    config: RaceConfig,
    scales: Sequence[float] = SCALES,
    *,
    policy: Policy | None = None,
    cars: int = 80,
    seconds: float = 40.0,
    seed: int = 0,
    threads: int | None = None,
) -> NDArray[np.float64]:
    """Probability that a car alone crashes within 40 s, at each speed scale.

    Cars start on the race line at its speed, spread evenly around the circuit; each race holds two of them, half a
    lap apart.

    Parameters
    ----------
    track : Track
    config : RaceConfig
        Its steering noise is what makes the hazard smooth.
    scales : sequence of float
        Speed scales.
    policy : Policy, optional
        A lattice policy; its pace is overridden. The default driver if absent.
    cars : int
        Cars per scale, even.
    seconds : float
        How long they drive.
    seed : int
        Root of the noise.
    threads : int, optional
        Threads to use; they do not change the result.

    Returns
    -------
    ndarray, shape (len(scales),)
    """
    if cars < 2 or cars % 2:
        raise InputError(f"cars is {cars}; it must be an even number from 2")
    driver = policy or LATTICE.policy()
    races = cars // 2
    hazards = []
    for scale in scales:
        at_scale = replace(config, speed_range=(scale, scale + 1e-6), duration=seconds)
        setup = RaceSetup(track, at_scale, (LATTICE, LATTICE))
        state = empty_state(races, setup.memory_size)
        state.seed[:] = race_seeds(seed, races)
        for car in range(2):
            s = np.mod((np.arange(races) / races + car) * 0.5 * track.length, track.length)
            pose = track.to_cartesian(np.stack([s, np.zeros(races)], axis=-1))
            sample = (s / track.arrays.ds).astype(np.intp) % len(track.arrays.line)
            state.cars[:, car, :2] = pose[:, :2]
            state.cars[:, car, _vehicle.PSI] = np.mod(pose[:, 2], 2.0 * np.pi)
            state.cars[:, car, _vehicle.V] = scale * track.arrays.line[sample, SPEED]
            state.frenet[:, car, 0] = s
            state.progress[:, car] = 0.5 * car * track.length
        theta = np.ascontiguousarray(
            np.broadcast_to(pad_parameters([driver], setup.theta_size)[:, None], (races, 2, setup.theta_size))
        )
        advance(setup, state, theta, at_scale.ticks, threads=threads)
        # A race ends for both cars at the first crash, so count crashes per time driven rather than per car.
        driven = 2.0 * DT * float(state.tick.sum())
        hazards.append(1.0 - exponential(-40.0 * float((state.crash == 1).sum()) / driven))
    return np.array(hazards)


def calibrate(
    track: Track, config: RaceConfig, *, cars: int = 160, seed: int = 0, threads: int | None = None
) -> CalibrationReport:
    """Find the speed range of a circuit for a race configuration.

    Without steering noise (preset ``paper``) the hazard is a step, and racing needs room to it: pace 1 lies 0.09 below
    the scale at which a car alone begins to crash, pace 0 another 0.20 below. With noise (``contest``) pace 1 is the
    scale at which a car alone crashes in 45 % of 40 s, and pace 0 lies 0.32 below.

    Raises
    ------
    InputError
        If even the slowest scale is beyond the hazard allowed: then the circuit is too tight for these cars.
    """
    hazard = np.maximum.accumulate(hazard_scan(track, config, cars=cars, seed=seed, threads=threads))
    scales = np.array(SCALES)
    noisy = config.steering_noise > 0.0
    allowed = HAZARD_WITH_NOISE if noisy else HAZARD_WITHOUT_NOISE
    if hazard[0] > allowed:
        raise InputError(
            f"track {track.name!r}: at speed scale {scales[0]:.2f} a car alone crashes in {hazard[0]:.0%} of 40 s; "
            "widen the track or lower steering_noise"
        )
    high = _crossing(scales, hazard, allowed) - (0.0 if noisy else BELOW_IT)
    low = high - (WIDTH_WITH_NOISE if noisy else WIDTH_WITHOUT_NOISE)
    return CalibrationReport(
        track.name,
        config.name,
        SCALES,
        tuple(np.round(hazard, 4).tolist()),
        (round(float(low), 2), round(float(high), 2)),
    )


def _crossing(scales: NDArray[np.float64], hazard: NDArray[np.float64], level: float) -> float:
    """Scale at which a hazard that begins below a level first exceeds it; the last scale if it never does."""
    above = np.flatnonzero(hazard > level)
    if len(above) == 0:
        return float(scales[-1])
    i = int(above[0])
    share = (level - hazard[i - 1]) / (hazard[i] - hazard[i - 1])
    return float(scales[i - 1] + share * (scales[i] - scales[i - 1]))
