"""Small recorded races, for tests of replays, their files and their frames; and a driver in plain
Python.
"""

import numpy as np

from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.view import OWN_D, OWN_PSI, OWN_S
from pcs_racing.race.replay import Replay, ReplayEvent
from pcs_racing.track.frenet import SPEED


def towards_the_line(track, theta, view, memory):
    """A driver in plain Python: back to the race line, at a share of its speed; remembers how often
    it was asked.
    """
    memory[0] += 1.0
    sample = track.line[int(view[OWN_S] / track.arrays.ds) % len(track.line)]
    turn = np.mod(sample[4] - view[OWN_PSI] + np.pi, 2.0 * np.pi) - np.pi
    return 1.2 * turn - 0.6 * view[OWN_D] + 0.33 * sample[5], theta[0] * sample[SPEED]


PYTHON = Planner(
    "python",
    (Parameter("pace", 0.1, 1.0, 0.7, "share of the speed"),),
    drive=towards_the_line,
    memory_size=1,
)


def race_on_a_straight():
    """Two cars side by side for a second on the lower straight of a rectangular track of 20 m x 10
    m.
    """
    time = np.arange(21) * 0.05
    cars = np.zeros((21, 2, 7))
    cars[:, :, 0] = 5.0 + np.outer(time, [5.0, 4.0])
    cars[:, :, 1] = [1.2, 0.6]
    cars[:, :, 3] = [5.0, 4.0]
    corners = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 10.0], [0.0, 10.0], [0.0, 0.0]])
    inner = np.array([1.0, 0.9]) + corners * [0.9, 0.8]
    inner[:, 1] += 1.1
    paths = np.full((10, 2, 5, 4), np.nan)
    paths[:, :, :4, 0] = cars[:20:2, :, None, 0] + np.arange(4) * 0.5
    paths[:, :, :4, 1] = cars[:20:2, :, None, 1]
    paths[:, :, :4, 2:] = 0.0
    return Replay(
        title="straight",
        track_name="box",
        car_names=("a", "b"),
        cars=cars,
        progress=cars[:, :, 0],
        walls=np.vstack([np.hstack([loop[:-1], loop[1:]]) for loop in (corners, inner)]),
        line=np.array([[0.5, 0.9], [19.5, 0.9], [19.5, 9.5], [0.5, 9.5]]),
        half_sizes=np.array([[0.29, 0.155]] * 2),
        paths=paths,
    )


def race_on_a_circle(seconds=4.0, candidates=0, seed=0, **changes):
    """Two cars on circles around the origin, counterclockwise, with plans and any number of
    candidates.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds / 0.05) + 1) * 0.05
    radius, speed = np.array([9.7, 10.3]), np.array([5.0, 4.6])
    angle = 0.3 + speed * time[:, None] / radius
    steering = np.broadcast_to(np.arctan(0.33 / radius), angle.shape) + 0.02 * rng.standard_normal(
        angle.shape
    )
    rest = (
        np.broadcast_to(speed, angle.shape),
        angle + np.pi / 2,
        np.broadcast_to(speed / radius, angle.shape),
    )
    cars = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), steering, *rest, 0.0 * angle], axis=-1
    )

    ahead = np.linspace(0.0, 1.0, 12)
    turn = angle[:-1:2, :, None] + speed[:, None] * ahead / radius[:, None]
    points = [radius[:, None] * np.cos(turn), radius[:, None] * np.sin(turn)]
    paths = np.stack(
        [*points, np.broadcast_to(speed[:, None], turn.shape), np.broadcast_to(ahead, turn.shape)],
        axis=-1,
    )
    extra = {}
    if candidates:
        bend = np.linspace(-0.8, 0.8, candidates)[:, None] * ahead[:10] ** 2
        wide = (radius[:, None, None] + bend)[..., None]
        turn = turn[:, :, None, :10, None]
        extra["candidates"] = wide * np.concatenate([np.cos(turn), np.sin(turn)], axis=-1)
        costs = 1.0 + bend[:, -1] ** 2 + 0.1 * rng.random((len(paths), 2, candidates))
        extra["costs"] = np.where(bend[:, -1] > 0.6 * bend[-1, -1], np.inf, costs)

    around = np.linspace(0.0, 2.0 * np.pi, 65)
    loops = [r * np.column_stack([np.cos(around), np.sin(around)]) for r in (8.9, 11.1)]
    fields = {
        "title": "A race on a circle",
        "track_name": "circle",
        "car_names": ("inner", "outer"),
        "cars": cars,
        "progress": angle * 10.0,
        "walls": np.vstack([np.hstack([loop[:-1], loop[1:]]) for loop in loops]),
        "line": 10.0 * np.column_stack([np.cos(around), np.sin(around)])[:-1],
        "half_sizes": np.array([[0.29, 0.155]] * 2),
        # No car drove at the first point.
        "line_speed": np.append(np.nan, 5.0 + np.cos(around[1:-1])),
        "ittc": np.full((len(time), 2), 2.0),
        "paths": paths,
        "events": (
            ReplayEvent(seconds / 2, 0, "move", "aggressiveness +"),
            ReplayEvent(seconds, 1, "crash", "wall"),
        ),
        "outcome": "inner wins",
    }
    return Replay(**(fields | extra | changes))
