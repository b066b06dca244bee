"""The overtaking protocol of End2Race [1]_: 600 scenarios per track with a slower car 3 m ahead.

Both cars start at rest, at 50 places, and race for 8 s. The opponent drives one of three lines at
one of four speed factors (:mod:`studies.overtaking.overtaken`). A scenario ends in a
collision as soon as either car touches a wall or the other car. Without a collision, the ego has
overtaken if it is ahead at the end, and has followed otherwise.

Lines are read from files ``CIRCUIT_line0.csv`` to ``CIRCUIT_line2.csv`` in a folder (columns s; x;
y; heading; curvature; speed; acceleration; the ego drives on line 1), or are made here: the race
line, and a lane on each side of it.

References
----------
.. [1] End2Race, arXiv:2509.16894.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import MapError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.base.typing import Floats
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.planners.planner import Policy
from pcs_racing.race.conditions import AS_THE_SETUP
from pcs_racing.race.config import Rules
from pcs_racing.race.driving import BareField, advance, kernel_settings
from pcs_racing.race.start_grid import settle
from pcs_racing.race.state import empty_state
from pcs_racing.track.building.tracks import build_track
from pcs_racing.track.frenet import KAPPA, LEFT, RIGHT, SPEED, X, Y
from pcs_racing.track.map_files import parse_csv
from pcs_racing.track.maps import read_inside
from pcs_racing.track.track import Track
from pcs_racing_agents.base.statistics import clustered_mean
from pcs_racing_agents.base.tables import aligned
from studies.overtaking.overtaken import overtaken

STARTS, LINES, FACTORS = 50, 3, (0.5, 0.6, 0.7, 0.8)
AHEAD = 3.0  # m: 15 way points
SPEED_RANGE = (0.8, 1.2)  # speed profile's scales at pace 0 and 1 (1.0 at the default pace 0.5)
RULES = Rules(name="overtaking", duration=8.0, speed_range=SPEED_RANGE)
ASIDE, WALL_AIR = 0.57, 0.45  # m: distance of made lanes from the race line, min distance to walls
SPACING = 0.5  # m: sample spacing of a line
COLUMNS = ("s", "x", "y", "heading", "curvature", "speed", "acceleration")
MAX_LINE = 16 * 2**20  # bytes: size of a line's file
MAX_SPEED = 20.0  # m/s
MAX_GAP = 2.0  # m: spacing of a line's points
MERGE = 8  # samples before and behind a narrow place, for a lane's transition
PUBLISHED = ("End2Race, published", 0.942, 0.592)  # collision-free and overtaking; n = 2,400


class Lines(NamedTuple):
    """A track with line 1 as its race line, and the lines along it."""

    track: Track
    d: Floats  #: shape (3, M): Distances from line 1 at its evenly spaced arc lengths, m.
    speed: Floats  #: shape (3, M): Speeds, m/s.


def made_lines(track: Track) -> Lines:
    """Return a track's race line and lanes next to it, with profile speeds for their radius."""
    samples = track.line[(_places(track) / track.arrays.ds).astype(np.intp)]
    room = np.stack([samples[:, LEFT], samples[:, LEFT], samples[:, RIGHT]]) - WALL_AIR
    # Moving minimum of the room for early transitions of a lane, then a mean for slow transitions.
    around = np.stack(
        [np.roll(np.clip(room, 0.0, ASIDE), k, axis=1) for k in range(-MERGE, MERGE + 1)]
    )
    room_around = np.stack(
        [np.roll(around.min(axis=0), k, axis=1) for k in range(-MERGE, MERGE + 1)]
    ).mean(axis=0)
    d = np.array([[1.0], [0.0], [-1.0]]) * room_around
    speed = samples[:, SPEED] * np.sqrt(np.clip(1.0 - samples[:, KAPPA] * d, 0.25, 1.0))
    return Lines(track, d, speed)


def read_lines(track: Track, folder: Path) -> Lines:
    """Return the lines of a folder; line 1, in its direction, becomes the track's race line."""
    paths = [folder / f"{track.name}_line{k}.csv" for k in range(LINES)]
    tables = [_checked_line(track, path) for path in paths]
    arrays, center = track.arrays, track.centerline
    if np.median(np.diff(track.to_frenet(tables[1][:, 1:3])[:, 0])) < 0.0:
        center = center[::-1][:, [0, 1, 3, 2]]
    corner = (arrays.origin_x, arrays.origin_y)
    on = build_track(
        track.name, arrays.distance <= 0.0, arrays.cell, corner, center, tables[1][:, 1:3]
    )
    places = _places(on)
    d, speed = np.empty((2, LINES, len(places)))
    for k, table in enumerate(tables):
        sd = on.to_frenet(table[:, 1:3])
        # np.interp sorts the points of a period.
        d[k] = np.interp(places, sd[:, 0], sd[:, 1], period=on.length)
        speed[k] = np.interp(places, sd[:, 0], table[:, 5], period=on.length)
    return Lines(on, d, speed)


def _checked_line(track: Track, path: Path) -> Floats:
    """Return the table of a line from its file, after a check of all points."""
    table = parse_csv(path, read_inside(path.parent, path, MAX_LINE), COLUMNS, ";")
    xy, speed, half = table[:, 1:3], table[:, 5], 0.5 * track.length
    for wrong, right in (
        (np.diff(table[:, 0], append=np.inf) <= 0.0, "s must rise from point to point"),
        (
            (speed <= 0.0) | (speed > MAX_SPEED),
            f"the speed must be above 0 and at most {MAX_SPEED:g} m/s",
        ),
        (track.wall_distance(xy) <= 0.0, "it must lie between the walls"),
        (
            np.hypot(*np.diff(xy, axis=0, append=xy[:1]).T) > MAX_GAP,
            f"the next point must be within {MAX_GAP:g} m",
        ),
    ):
        if wrong.any():
            raise MapError(f"{path}, point {np.argmax(wrong) + 1}: {right}")
    # The sum is 0 or a multiple of the lap length, since the line is closed.
    steps = np.mod(np.diff(s := track.to_frenet(xy)[:, 0], append=s[0]) + half, track.length) - half
    if round(abs(steps.sum()) / track.length) != 1:
        raise MapError(f"{path} must go round {track.name} once")
    return table


def _places(track: Track) -> Floats:
    number = round(track.length / SPACING)
    return np.arange(number) / number * track.length


class Outcomes(NamedTuple):
    """Outcomes of a planner's scenarios, one entry per scenario."""

    start: NDArray[np.str_]  #: Track and number of the start: the clusters.
    circuit: NDArray[np.str_]
    factor: Floats
    line: NDArray[np.int64]
    fault: NDArray[np.int64]  #: Fault of a collision: 1 ego, 2 opponent, 3 both; 0 no collision.
    overtakes: NDArray[np.bool_]  #: True if the ego is ahead at the end, without a collision.

    @property
    def safe(self) -> NDArray[np.bool_]:
        """True without a collision."""
        return self.fault == 0


def race_scenarios(
    lines: Lines, ego: Policy, *, seed: int = 0, threads: int | None = None
) -> Outcomes:
    """Drive the 600 scenarios of a track."""
    track, samples = lines.track, lines.d.shape[1]
    scenarios = np.array(list(product(range(STARTS), range(LINES), range(len(FACTORS)))))
    start, line, factor = scenarios.T
    d, speed, races = lines.d[line], lines.speed[line], len(scenarios)
    planners, cars = (ego.planner, overtaken(samples)), (F1TENTH, F1TENTH)
    opponent = np.column_stack([np.array(FACTORS)[factor], np.full(races, samples), d, speed])
    theta = np.zeros((races, 2, max(len(ego.parameters), opponent.shape[1])))
    theta[:, 0, : len(ego.parameters)] = ego.parameters
    theta[:, 1, : opponent.shape[1]] = opponent
    state = empty_state(races, max(planner.memory_total for planner in planners))
    state.seed[:] = race_seeds(seed, races)
    for car, ahead in ((0, 0.0), (1, AHEAD)):
        s = np.mod(start / STARTS * track.length + ahead, track.length)
        sample = (s / track.length * samples).astype(np.intp) % samples
        aside = d[np.arange(races), sample] if car else np.zeros(races)
        pose = track.to_cartesian(np.stack([s, aside], axis=-1))
        state.cars[:, car, X], state.cars[:, car, Y] = pose[:, 0], pose[:, 1]
        state.cars[:, car, _vehicle.PSI] = np.mod(pose[:, 2], 2.0 * np.pi)
        state.progress[:, car] = ahead
    settle(track, cars, state, AS_THE_SETUP)
    field = BareField(track, kernel_settings(RULES, SPEED_RANGE), planners, cars)
    advance(field, state, theta, RULES.ticks, threads=threads, ittc=False)
    fault = np.where(state.crashed, (state.fault > 0) @ [1, 2], 0)
    names = np.full(races, track.name)
    label = np.char.add(np.char.add(names, " "), start.astype(str))
    overtakes = (state.lead > 0.0) & ~state.crashed
    return Outcomes(label, names, np.array(FACTORS)[factor], line, fault, overtakes)


def joined(parts: Sequence[Outcomes]) -> Outcomes:
    """Return the joined outcomes of one planner on several tracks."""
    return Outcomes(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _share(values: NDArray[np.bool_], starts: NDArray[np.str_]) -> str:
    found = clustered_mean(values.astype(float), starts)
    return f"{found.mean:.1%} [{max(found.low, 0.0):.1%}, {min(found.high, 1.0):.1%}]"


HEAD = "without collision", "overtaking", "following", "collision: ego", "opponent", "both"


def summary(found: Mapping[str, Outcomes]) -> list[str]:
    """Return the table of planners: shares (95 % intervals, clusters: starts), collision faults."""
    rows: list[Sequence[str]] = [("planner", *HEAD)]
    for planner, one in found.items():
        shares = (one.safe, one.overtakes, one.safe & ~one.overtakes)
        faults = (f"{np.mean(one.fault == k):.1%}" for k in (1, 2, 3))
        rows.append((planner, *(_share(values, one.start) for values in shares), *faults))
    name, safe, overtakes = PUBLISHED
    rows.append((name, f"{safe:.1%}", f"{overtakes:.1%}", f"{safe - overtakes:.1%}", "-", "-", "-"))
    return aligned(rows, left=1)


def detail(found: Mapping[str, Outcomes]) -> list[str]:
    """Return the shares without collision / with overtaking by track, speed factor and line."""
    rows: list[Sequence[str]] = []
    for planner, one in found.items():
        groups = {name: one.circuit == name for name in dict.fromkeys(one.circuit.tolist())}
        groups |= {f"speed {factor:g}": one.factor == factor for factor in FACTORS}
        groups |= {f"line {line}": one.line == line for line in range(LINES)}
        rows = rows or [("planner", *groups)]
        shares = [
            f"{one.safe[on].mean():.1%} / {one.overtakes[on].mean():.1%}" for on in groups.values()
        ]
        rows.append((planner, *shares))
    return aligned(rows, left=1)
