"""Shared parts of lidar-only planners: the scan, its farthest beam, and the arc of a direction.

A lidar-only planner has no map. It lays its path from the pose of its odometry, which is exact for
the tenth of a second until the next path, and `follow_scan` follows the path by it.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import compiled, kernel
from pcs_racing.base.elementary import sine_cosine, tangent
from pcs_racing.car.collision import Rectangle
from pcs_racing.car.lidar_errors import disturb_scan, lidar_place
from pcs_racing.car.lidar_kernel import WORK_SHAPE, Beams, Pose, scan_into, scan_moving
from pcs_racing.planners import view as _view
from pcs_racing.planners.pursuit import follow_path, steady_course, write_point


def sine_tables(angles: Iterable[float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return sines and cosines of angles (rad), without compiled code.

    A call of compiled code would slow down every import.
    """
    plain = getattr(sine_cosine, "py_func", sine_cosine)
    sines, cosines = zip(*map(plain, angles), strict=True)
    return np.array(sines), np.array(cosines)


BEAMS = 271
# rad, as for the lidar of most cars, with 1080 beams; every fourth beam is used here
FIELD_OF_VIEW = 4.7
MAX_RANGE = 15.0  # m
STEP = FIELD_OF_VIEW / (BEAMS - 1)
ANGLES = np.linspace(-0.5 * FIELD_OF_VIEW, 0.5 * FIELD_OF_VIEW, BEAMS)
"""Directions of the beams in rad, from right to left; 0 is straight ahead."""
RIGHT_BEAM, LEFT_BEAM = (
    int((side * 0.5 * np.pi + 0.5 * FIELD_OF_VIEW) / STEP + 0.5) for side in (-1.0, 1.0)
)
"""Beams to the right and to the left of the car, a quarter turn from straight ahead."""
SIN, COS = sine_tables(ANGLES)
WORK = WORK_SHAPE[0] * WORK_SHAPE[1]
SCAN_SIZE = WORK + BEAMS
"""Size of a scan in the scratch: the lidar's own working memory, and the ranges at the end."""


@kernel(forceinline=True)
def use_odometry(view):
    """Replace the own pose of a view, from the localisation, by the exact pose."""
    view[_view.OWN_X], view[_view.OWN_Y] = view[_view.TRUE_X], view[_view.TRUE_Y]
    view[_view.OWN_PSI] = view[_view.TRUE_PSI]
    view[_view.OWN_S], view[_view.OWN_D] = view[_view.TRUE_S], view[_view.TRUE_D]


@compiled
def scan_beams(track, beams, view, turn, work, ranges):
    """Scan from the lidar of the own car with any beams, turned by ``turn`` (rad) from its heading.

    The scan has the errors of the car's lidar. ``work`` holds `WORK` numbers.
    """
    x, y, psi, s = (
        view[_view.TRUE_X],
        view[_view.TRUE_Y],
        view[_view.TRUE_PSI],
        view[_view.TRUE_S],
    )
    x, y, s = lidar_place(track, x, y, psi, s, view[_view.LIDAR_X], view[_view.LIDAR_Y])
    other = Rectangle(
        view[_view.TRUE_OPP_X],
        view[_view.TRUE_OPP_Y],
        view[_view.TRUE_OPP_PSI],
        0.5 * view[_view.TRUE_OPP_LENGTH],
        0.5 * view[_view.TRUE_OPP_WIDTH],
    )
    pose = Pose(x, y, psi + view[_view.LIDAR_YAW] + turn)
    lanes = work.reshape(WORK_SHAPE)
    scan_into(track, beams, pose, s, True, other, lanes, ranges)
    if track.moving.shape[0] > 0:
        for k in range(ranges.shape[0]):
            ranges[k] = 1.0 / ranges[k]
        scan_moving(track, beams, pose, view[_view.TIME], lanes, ranges)
        for k in range(ranges.shape[0]):
            ranges[k] = 1.0 / ranges[k]
    key = np.uint64(view[_view.SCAN_KEY] * 2.0**53)
    errors = view[_view.LIDAR_FOV : _view.LIDAR_STEP + 1]
    disturb_scan(beams, turn, errors, key, 0, 0, ranges)


@compiled
def scan(track, view, scratch):
    """Scan from the lidar of the own car along its heading, and use the odometry from now on.

    Returns the ranges (m), which are ``scratch[SCAN_SIZE - BEAMS : SCAN_SIZE]``.
    """
    use_odometry(view)
    beams, ranges = Beams(ANGLES[0], STEP, MAX_RANGE, COS, SIN), scratch[WORK:SCAN_SIZE]
    scan_beams(track, beams, view, 0.0, scratch[:WORK], ranges)
    return ranges


@kernel
def follow_scan(track, theta, view, memory, scratch, path, command):
    """Follow the path of a lidar-only planner: :func:`pcs_racing.planners.pursuit.follow_path` by
    odometry.
    """
    use_odometry(view)
    follow_path(track, theta, view, memory, scratch, path, command)


@kernel
def farthest(ranges, angles, first, end):
    """Return the beam with the max range, from the beam ``first`` to the beam before ``end``.

    Of equal ranges (at the lidar's limit), the beam nearest to straight ahead counts.
    """
    best = first
    for k in range(first + 1, end):
        as_long = ranges[k] == ranges[best] and abs(angles[k]) < abs(angles[best])
        if ranges[k] > ranges[best] or as_long:
            best = k
    return best


@kernel
def write_arc(view, course, kappa, length, speed, path):
    """Write an arc by its first course (rad), curvature (1/m), length (m) and speed (m/s)."""
    for j in range(_view.PATH_POINTS):
        s = length * j / (_view.PATH_POINTS - 1)
        bend = 0.5 * kappa * s
        sine, _ = sine_cosine(bend)
        chord = s * sine / bend if bend != 0.0 else s
        sine, cosine = sine_cosine(course + bend)
        x, y = view[_view.OWN_X] + chord * cosine, view[_view.OWN_Y] + chord * sine
        write_point(path, j, x, y, speed, kappa)


@kernel
def steer_for(view, steering, speed, lateral, path):
    """Write the arc of a steering angle (rad), at a speed (m/s).

    The speed is limited by a lateral acceleration (m/s^2).
    """
    limit = view[_view.STEER_MAX]
    kappa = tangent(min(max(steering, -limit), limit)) / view[_view.WHEELBASE]
    speed = min(speed, np.sqrt(lateral / max(abs(kappa), 1e-6)))
    course = steady_course(view, kappa)  # start of the pursuit's own arc: it steers as asked
    write_arc(view, course, kappa, 0.5 + 0.25 * view[_view.OWN_V], speed, path)
