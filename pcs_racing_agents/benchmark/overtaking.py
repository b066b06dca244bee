"""The overtaking protocol of End2Race [1]_: 600 scenarios a circuit in which a slower car starts 3 m ahead.

Both cars start at rest, at 50 places, and race for 8 s. The opponent drives one of three lines at one of four factors
of its speed (:mod:`pcs_racing_agents.benchmark.overtaken`). A scenario ends in a collision as soon as either car
touches a wall or the other car; else the ego has overtaken if it is ahead at the end, and else it follows.

Lines come from a folder of files ``CIRCUIT_line0.csv`` to ``CIRCUIT_line2.csv`` (columns s; x; y; heading; curvature;
speed; acceleration, the ego drives on line 1), or are made here: the race line, and lanes to both sides of it.

References
----------
.. [1] End2Race, arXiv:2509.16894.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import MapError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.planners.planner import Policy
from pcs_racing.race.conditions import AS_THE_SETUP
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.driving import drive, kernel_settings
from pcs_racing.race.start_grid import settle
from pcs_racing.race.state import empty_state
from pcs_racing.track.frenet import KAPPA, LEFT, RIGHT, SPEED, X, Y
from pcs_racing.track.map_files import parse_csv
from pcs_racing.track.maps import read_inside
from pcs_racing.track.track import Track, build_track
from pcs_racing_agents.base.tables import aligned
from pcs_racing_agents.benchmark.overtaken import overtaken
from pcs_racing_agents.tournament.statistics import clustered_mean

STARTS, LINES, FACTORS = 50, 3, (0.5, 0.6, 0.7, 0.8)
AHEAD = 3.0  # m: 15 way points
SPEED_RANGE = (0.8, 1.2)  # scales of the speed profile of pace 0 and 1: at the default pace of .5 it is the profile
RULES = RaceConfig(name="overtaking", duration=8.0, speed_range=SPEED_RANGE)
ASIDE, WALL_AIR = 0.57, 0.45  # m: distance of the lanes that are made here from the race line, and least to a wall
SPACING = 0.5  # m between the samples of a line
COLUMNS = ("s", "x", "y", "heading", "curvature", "speed", "acceleration")
MAX_LINE = 16 * 2**20  # bytes of a file of a line
MAX_SPEED = 20.0  # m/s
MAX_GAP = 2.0  # m between two points of a line
MERGE = 8  # samples before and behind a narrow place over which a lane comes in
PUBLISHED = ("End2Race, published", 0.942, 0.592)  # shares without collision and overtaking, of 2,400 scenarios

Floats = NDArray[np.float64]


class Lines(NamedTuple):
    """A circuit whose race line is line 1, and the lines along it."""

    track: Track
    d: Floats  #: shape (3, M): Distances from line 1 at evenly spaced arc lengths of it, m.
    speed: Floats  #: shape (3, M): m/s.


def made_lines(track: Track) -> Lines:
    """Return the race line of a circuit and lanes beside it, with the speeds of the profile on their radius."""
    samples = track.line[(_places(track) / track.arrays.ds).astype(np.intp)]
    room = np.stack([samples[:, LEFT], samples[:, LEFT], samples[:, RIGHT]]) - WALL_AIR
    # The least room within some metres, so that a lane comes in early, and then its mean, so that it comes in slowly.
    around = np.stack([np.roll(np.clip(room, 0.0, ASIDE), k, axis=1) for k in range(-MERGE, MERGE + 1)])
    least = np.stack([np.roll(around.min(axis=0), k, axis=1) for k in range(-MERGE, MERGE + 1)]).mean(axis=0)
    d = np.array([[1.0], [0.0], [-1.0]]) * least
    speed = samples[:, SPEED] * np.sqrt(np.clip(1.0 - samples[:, KAPPA] * d, 0.25, 1.0))
    return Lines(track, d, speed)


def read_lines(track: Track, folder: Path) -> Lines:
    """Return the lines of a folder on a circuit; line 1, in its direction, becomes the circuit's race line."""
    tables = []
    for k in range(LINES):
        path = folder / f"{track.name}_line{k}.csv"
        tables.append(_checked(track, path, parse_csv(path, read_inside(folder, path, MAX_LINE), COLUMNS, ";")))
    arrays, center = track.arrays, track.centerline
    if np.median(np.diff(track.to_frenet(tables[1][:, 1:3])[:, 0])) < 0.0:
        center = center[::-1][:, [0, 1, 3, 2]]
    corner = (arrays.origin_x, arrays.origin_y)
    on = build_track(track.name, arrays.distance <= 0.0, arrays.cell, corner, center, tables[1][:, 1:3])
    places = _places(on)
    d, speed = np.empty((2, LINES, len(places)))
    for k, table in enumerate(tables):
        sd = on.to_frenet(table[:, 1:3])
        d[k] = np.interp(places, *_rising(sd[:, 0], sd[:, 1]), period=on.length)
        speed[k] = np.interp(places, *_rising(sd[:, 0], table[:, 5]), period=on.length)
    return Lines(on, d, speed)


def _checked(track: Track, path: Path, table: Floats) -> Floats:
    """Return the table of a line, of which all points are checked."""
    xy, speed, half = table[:, 1:3], table[:, 5], 0.5 * track.length
    for wrong, right in (
        (np.diff(table[:, 0], append=np.inf) <= 0.0, "s must rise from point to point"),
        ((speed <= 0.0) | (speed > MAX_SPEED), f"the speed must be above 0 and at most {MAX_SPEED:g} m/s"),
        (track.wall_distance(xy) <= 0.0, "it must lie between the walls"),
        (np.hypot(*np.diff(xy, axis=0, append=xy[:1]).T) > MAX_GAP, f"the next point must be within {MAX_GAP:g} m"),
    ):
        if wrong.any():
            raise MapError(f"{path}, point {np.argmax(wrong) + 1}: {right}")
    # The sum is 0 or a number of laps, since the line is closed.
    steps = np.mod(np.diff(s := track.to_frenet(xy)[:, 0], append=s[0]) + half, track.length) - half
    if round(abs(steps.sum()) / track.length) != 1:
        raise MapError(f"{path} must go round {track.name} once")
    return table


def _places(track: Track) -> Floats:
    number = round(track.length / SPACING)
    return np.arange(number) / number * track.length


def _rising(s: Floats, values: Floats) -> tuple[Floats, Floats]:
    order = np.argsort(s)
    return s[order], values[order]


@dataclass(frozen=True, eq=False)
class Outcomes:
    """What came of the scenarios of one driver; all arrays have one entry for each."""

    driver: str
    start: NDArray[np.str_]  #: Circuit and number of the start: the clusters.
    circuit: NDArray[np.str_]
    factor: Floats
    line: NDArray[np.int64]
    fault: NDArray[np.int64]  #: Of a collision: 1 of the ego, 2 of the opponent, 3 of both; 0 without a collision.
    overtakes: NDArray[np.bool_]  #: Without a collision, whether the ego is ahead at the end.

    @property
    def safe(self) -> NDArray[np.bool_]:
        """Whether there was no collision."""
        return self.fault == 0


def race_scenarios(lines: Lines, ego: Policy, *, seed: int = 0, threads: int | None = None) -> Outcomes:
    """Drive the 600 scenarios of a circuit."""
    track, samples = lines.track, lines.d.shape[1]
    scenarios = np.array(list(product(range(STARTS), range(LINES), range(len(FACTORS)))))
    start, line, factor = scenarios.T
    planners, cars, races = (ego.planner, overtaken(samples)), (F1TENTH, F1TENTH), len(scenarios)
    theta = np.zeros((races, 2, max(len(planner.parameters) for planner in planners)))
    theta[:, 0, : len(ego.parameters)] = ego.parameters
    theta[:, 1, 0], theta[:, 1, 1] = np.array(FACTORS)[factor], samples
    theta[:, 1, 2 : 2 + samples], theta[:, 1, 2 + samples : 2 + 2 * samples] = lines.d[line], lines.speed[line]
    state = empty_state(races, max(planner.memory_total for planner in planners))
    state.seed[:] = race_seeds(seed, races)
    begins = start / STARTS * track.length
    for car, ahead in ((0, 0.0), (1, AHEAD)):
        s = np.mod(begins + ahead, track.length)
        d = lines.d[line, (s / track.length * samples).astype(np.intp) % samples] if car else np.zeros(races)
        pose = track.to_cartesian(np.stack([s, d], axis=-1))
        state.cars[:, car, X], state.cars[:, car, Y] = pose[:, 0], pose[:, 1]
        state.cars[:, car, _vehicle.PSI] = np.mod(pose[:, 2], 2.0 * np.pi)
        state.progress[:, car] = ahead
    settle(track, cars, state, AS_THE_SETUP)
    settings = kernel_settings(RULES, SPEED_RANGE)._replace(ittc_horizon=0.0)
    drive(track, settings, planners, cars, state, theta, RULES.ticks, threads=threads)
    fault = np.where(state.crashed, (state.fault > 0) @ [1, 2], 0)
    names = np.full(races, track.name)
    label = np.char.add(np.char.add(names, " "), start.astype(str))
    overtakes = (state.lead > 0.0) & ~state.crashed
    return Outcomes(ego.name, label, names, np.array(FACTORS)[factor], line, fault, overtakes)


def joined(parts: Sequence[Outcomes]) -> Outcomes:
    """Return the outcomes of one driver on several circuits as one."""
    names = [name for name in Outcomes.__dataclass_fields__ if name != "driver"]
    return Outcomes(parts[0].driver, **{name: np.concatenate([getattr(p, name) for p in parts]) for name in names})


def _share(values: NDArray[np.bool_], starts: NDArray[np.str_]) -> str:
    found = clustered_mean(values.astype(float), starts)
    return f"{found.mean:.1%} [{max(found.low, 0.0):.1%}, {min(found.high, 1.0):.1%}]"


def summary(found: Sequence[Outcomes]) -> list[str]:
    """Return the table of drivers: shares with 95 % intervals clustered by start, and whose fault collisions were."""
    rows: list[tuple[str, ...]] = [
        ("driver", "without collision", "overtaking", "following", "collision: ego", "opponent", "both")
    ]
    for one in found:
        shares = [_share(values, one.start) for values in (one.safe, one.overtakes, one.safe & ~one.overtakes)]
        rows.append((one.driver, *shares, *(f"{np.mean(one.fault == k):.1%}" for k in (1, 2, 3))))
    name, safe, overtakes = PUBLISHED
    rows.append((name, f"{safe:.1%}", f"{overtakes:.1%}", f"{safe - overtakes:.1%}", "-", "-", "-"))
    return aligned(rows, left=1)


def _groups(one: Outcomes) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    for name in dict.fromkeys(one.circuit.tolist()):
        yield name, one.circuit == name
    for factor in FACTORS:
        yield f"speed {factor:g}", one.factor == factor
    for line in range(LINES):
        yield f"line {line}", one.line == line


def detail(found: Sequence[Outcomes]) -> list[str]:
    """Return a table of shares without collision / overtaking, by circuit, by factor of the speed and by line."""
    head = ["driver", *(name for name, _ in _groups(found[0]))]
    rows = [
        [one.driver, *(f"{one.safe[on].mean():.1%} / {one.overtakes[on].mean():.1%}" for _, on in _groups(one))]
        for one in found
    ]
    return aligned([head, *rows], left=1)
