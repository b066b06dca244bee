"""The race line of a track (closed, low curvature and length, clear of walls) and its speeds."""

import math

import numpy as np

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import headings, lengths
from pcs_racing.base.errors import MapError, check_number, require
from pcs_racing.track.building.centerline import around_islands
from pcs_racing.track.building.clearance import (
    CLEARANCE,
    checked_grid,
    corridor,
    room_at,
    wall_clearance,
)
from pcs_racing.track.building.curves import (
    clean_closed,
    curve_length,
    first_crossing,
    resample,
    sample_closed,
    smooth,
)
from pcs_racing.track.frenet import LATERAL_OF_PROFILE
from pcs_racing.track.grid import distance_to_walls

SPACING = 0.2  # point spacing of the result, m
ROUNDS = 20  # max number of quadratic programs of a pass
STEP = 0.25  # spacing of the moved points, m
REACH = 3.0  # max distance along a point's normal in the search for walls, m
TRUST = 0.5  # max move of a point in the first round of a pass, m: the program is linearised
PASSES = 40  # max number of passes of about 2.5 m each: enough to cross any track
GAIN = 0.0015  # min share of the lap time saved by a pass; below it the search ends
RESERVE = 5e-4  # additional clearance between points, m
SETTLED = 0.05  # moves below this are due to the walls' pixels, m
CHATTER = 0.1  # weight of the squared change of curvature along the line, m^2
# Weight of the length, 1/m^2: bends with a radius above about its power of -0.5, in m, are
# shortened rather than rounded.
LENGTH_WEIGHT = 0.08

# Limits of the speeds along a line:
BRAKING = 4.5  # m/s^2
ACCELERATION = 3.5  # m/s^2
TOP_SPEED = 8.0  # m/s


def minimum_curvature_raceline(
    centerline: np.ndarray,
    occupied: np.ndarray,
    resolution: float,
    origin: np.ndarray | tuple[float, float],
    *,
    clearance: float = CLEARANCE,
) -> np.ndarray:
    """Compute the closed line of min squared curvature with a ``clearance`` from all walls.

    Iterated linearised minimum curvature (Heilmeier et al. 2020, "Minimum curvature trajectory
    planning and control for an autonomous race car"): each point of a reference line moves along
    its normal by a distance from a quadratic program, and the result is the next reference. Unlike
    in that paper, the room on both sides is measured on the grid in every round, so crossing
    normals in a hairpin are harmless. A small weight on the length (Braghin et al. 2008, "Race
    driver model") prevents a drift to the outside of long bends (rounder but slower). Passes of
    such rounds are repeated until a pass no longer shortens the lap.

    Parameters
    ----------
    centerline : array_like, shape (M, 2) or wider
        Any closed line around the track in driving direction, with x and y in m as first columns.
    clearance : float
        Min distance of the line from the edge of the nearest wall cell, in m.

    Returns
    -------
    ndarray, shape (N, 2)
        Evenly spaced points in m, in the direction of ``centerline``, from next to its first point.
    """
    require("clarabel")
    grid, resolution, corner = checked_grid(occupied, resolution, origin)
    check_number("clearance", clearance, 0.0)
    line = clean_closed(np.asarray(centerline)[:, :2])
    line = around_islands(line, grid, resolution, corner)
    lap = math.inf
    for _ in range(PASSES):
        better = _pass(line, grid, resolution, corner, clearance)
        faster = _lap(better)
        if faster > (1.0 - GAIN) * lap:
            break
        line, lap = better, faster
    return line


def _pass(
    start: np.ndarray, grid: np.ndarray, resolution: float, corner: np.ndarray, clearance: float
) -> np.ndarray:
    """Return the line after rounds with a shrinking trust region; a point moves 2.5 m at most."""
    grid, corner = _crop(grid, resolution, corner, start)
    room = distance_to_walls(~grid, resolution)

    line = _reference(start, room, resolution, corner, clearance)
    # Between the moved points the line loses a little clearance: the next rounds add the loss.
    slack, trust = 0.005, TRUST
    shortfall = math.inf
    for _ in range(ROUNDS):
        line, moved = _improve(line, room, resolution, corner, clearance + slack, trust)
        trust = max(0.8 * trust, 0.02)
        # A moving line needs no check: the next round moves it again.
        if moved > SETTLED:
            continue
        result = resample(line, SPACING)
        dense = resample(result, 0.25 * resolution)
        free = wall_clearance(dense, grid, resolution, corner, clearance + 0.1)
        # Between two fine points the wall can be nearer by about
        # (resolution / 8)^2 / (2 clearance): less than RESERVE.
        shortfall = clearance + RESERVE - float(free.min())
        if shortfall <= 0.0:
            if first_crossing(result)[0] >= 0:
                x, y = result[first_crossing(result)[0]]
                raise MapError(
                    f"the race line crosses itself near ({x:.2f}, {y:.2f}): is the centre line"
                    " simple?"
                )
            return result
        slack += shortfall + 0.001
    if math.isinf(shortfall):
        raise MapError(
            f"no race line was found in {ROUNDS} rounds: the centre line may not follow the circuit"
        )
    x, y = dense[int(np.argmin(free))]
    raise MapError(
        f"no line keeps {clearance:.3f} m from the walls near ({x:.2f}, {y:.2f}): {free.min():.3f}"
        f" m is the best found in {ROUNDS} rounds"
    )


def raceline_rows(xy: np.ndarray) -> np.ndarray:
    """Return the rows of a ``NAME_raceline.csv``, shape (N + 1, 7), about 0.2 m apart.

    Arc length, x, y (m), heading (rad, in [-pi, pi)), curvature (1/m, positive to the left), speed
    (m/s) and acceleration to the next row (m/s^2). As in f1tenth_racetracks the last row repeats
    the first row, at s = length.
    """
    line = sample_closed(xy, SPACING)
    ds = line.length / len(line.xy)
    v = speed_profile(line.kappa, ds)
    ax = (np.roll(v, -1) ** 2 - v**2) / (2.0 * ds)
    psi = np.mod(line.psi + np.pi, 2.0 * np.pi) - np.pi
    rows = np.column_stack([np.arange(len(v)) * ds, line.xy, psi, line.kappa, v, ax])
    last = rows[0].copy()
    last[0] = line.length
    return np.vstack([rows, last])


def _crop(
    grid: np.ndarray, resolution: float, corner: np.ndarray, line: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the grid within ``REACH`` of a line's box; raise an error for a line off the grid."""
    height, width = grid.shape
    cells = np.floor((line - corner) / resolution).astype(int)  # column, row
    outside = ((cells < 0) | (cells >= (width, height))).any(axis=1)
    if outside.any():
        x, y = line[int(np.argmax(outside))]
        raise MapError(f"the centre line leaves the map at ({x:.2f}, {y:.2f})")
    more = math.ceil(REACH / resolution)
    col, row = np.maximum(cells.min(axis=0) - more, 0)
    last_col, last_row = cells.max(axis=0) + more + 1
    # A one-cell rim of walls closes the crop: outside the map there is no track.
    crop = np.pad(grid[row:last_row, col:last_col], 1, constant_values=True)
    return crop, corner + resolution * (np.array([col, row]) - 1)


def _reference(
    start: np.ndarray, room: np.ndarray, resolution: float, corner: np.ndarray, clearance: float
) -> np.ndarray:
    """Return the first reference: the centre line, as smooth as possible away from walls."""
    even = resample(start, STEP)
    # A smooth start saves rounds, except into a wall.
    for wavelength in (4.0, 2.0, 1.0):
        line = smooth(even, wavelength)
        if room_at(line, room, resolution, corner).min() >= 0.5 * clearance:
            return line
    return even


def _improve(
    line: np.ndarray,
    room: np.ndarray,
    resolution: float,
    corner: np.ndarray,
    need: float,
    trust: float,
) -> tuple[np.ndarray, float]:
    """Return the line after one round, and the longest move in m."""
    line = resample(line, STEP)
    ahead = np.roll(line, -1, axis=0) - line
    step = curve_length(line) / len(line)
    # Three-point curvature: unlike a spline's curvature it responds to a move like the program's
    # second differences, so rounds don't overshoot in the shortest waves.
    angle = headings(ahead)
    kappa = np.mod(angle - np.roll(angle, 1) + np.pi, 2.0 * np.pi) - np.pi
    kappa /= step
    along = ahead + np.roll(ahead, 1, axis=0)
    along /= lengths(along)[:, None]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    low, high = corridor(line, normal, room, resolution, corner, need, REACH)
    if (low > high).any():
        x, y = line[int(np.argmax(low > high))]
        raise MapError(
            f"the circuit is too narrow near ({x:.2f}, {y:.2f}): a line must have {need:.3f} m to"
            " both sides, half the width of a car and a margin, also next to an obstacle"
        )
    # A point stops short of its centre of curvature, where neighbours would meet.
    limit = np.minimum(trust, 0.8 / np.maximum(np.abs(kappa), 1e-9))
    high = np.maximum(np.minimum(high, np.where(kappa > 0.0, limit, trust)), low)
    low = np.minimum(np.maximum(low, -np.where(kappa < 0.0, limit, trust)), high)
    move = _solve(kappa, step, low, high)
    return line + move[:, None] * normal, float(np.abs(move).max())


def _solve(kappa: np.ndarray, step: float, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return moves a along left normals, low <= a <= high, that minimise a quadratic cost model.

    To first order a move changes the curvature to ``kappa + kappa^2 a + a''`` and the length
    element to ``1 - kappa a`` (plus ``a'^2 / 2``). The cost is the integral of kappa^2, of CHATTER
    times the squared change of kappa, and of LENGTH_WEIGHT.
    """
    import clarabel
    from scipy import sparse

    n = len(kappa)
    identity = sparse.identity(n, format="csc")
    shift = sparse.csc_matrix((np.ones(n), (np.arange(n), (np.arange(n) + 1) % n)), shape=(n, n))
    slope = (shift - identity) / step
    bend = sparse.diags(kappa**2) + (shift - 2.0 * identity + shift.T) / step**2
    metric = identity + CHATTER * (slope.T @ slope)
    P = 2.0 * bend.T @ metric @ bend + LENGTH_WEIGHT * slope.T @ slope
    q = 2.0 * bend.T @ (metric @ kappa) - kappa * kappa * kappa - LENGTH_WEIGHT * kappa
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.direct_solve_method = "qdldl"  # SSE2 at most on every processor
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-6
    # Both bounds of every move as one cone: high - a >= 0 and a - low >= 0.
    solver = clarabel.DefaultSolver(
        sparse.triu(P, format="csc"),
        q,
        sparse.vstack([identity, -identity], format="csc"),
        np.concatenate([high, -low]),
        [clarabel.NonnegativeConeT(2 * n)],
        settings,
    )
    return np.clip(np.asarray(solver.solve().x), low, high)


def speed_profile(kappa: np.ndarray, ds: float) -> np.ndarray:
    """Return max periodic speeds (m/s) within the four limits, for a closed line, ``ds`` m apart.

    The usual forward-backward sweep (e.g. Kapania, Subosits and Gerdes 2016, "A sequential two-step
    algorithm for fast generation of vehicle racing trajectories", without its coupling of lateral
    and longitudinal grip): the cornering speed ``sqrt(LATERAL_OF_PROFILE / |kappa|)`` (curvature in
    1/m) is lowered forwards to the motor's limit, and backwards to the brakes' limit.
    """
    # In squared speeds: constant acceleration is a straight line.
    cap = np.minimum(LATERAL_OF_PROFILE / np.maximum(np.abs(kappa), 1e-12), TOP_SPEED**2)
    return np.sqrt(_sweep(cap, ds))


def lap_time(v: np.ndarray, ds: float) -> float:
    """Return the lap time in s, at constant acceleration between samples (``ds`` m, ``v`` m/s)."""
    return float(np.sum(2.0 * ds / (v + np.roll(v, -1))))


def _lap(xy: np.ndarray) -> float:
    """Return the time of a lap on a line, s."""
    line = sample_closed(xy, SPACING)
    ds = line.length / len(line.xy)
    return lap_time(speed_profile(line.kappa, ds), ds)


@compiled
def _sweep(cap, ds):
    """Return squared speeds below ``cap`` that also respect acceleration and braking.

    The slowest sample is never lowered (all its neighbours are at least as fast), so one lap
    forwards and one lap backwards from it are exact and periodic.
    """
    n = cap.shape[0]
    w = cap.copy()
    first = np.argmin(cap)
    for k in range(n):
        i = (first + k) % n
        j = (i + 1) % n
        w[j] = min(w[j], w[i] + 2.0 * ACCELERATION * ds)
    for k in range(n):
        j = (first - k) % n
        i = (j - 1) % n
        w[i] = min(w[i], w[j] + 2.0 * BRAKING * ds)
    return w
