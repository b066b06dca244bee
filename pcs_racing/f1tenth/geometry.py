"""Compiled functions of the gym's ``collision_models`` and ``laser_models``, for programs."""

import numpy as np

from pcs_racing.base.compilation import compiled


@compiled
def get_vertices(pose, length, width):
    """Return the corners of a car at x, y, heading, shape (4, 2).

    The order is rear left, rear right, front right, front left.
    """
    sine, cosine = np.sin(pose[2]), np.cos(pose[2])
    corners = np.empty((4, 2))
    for i in range(4):
        along = 0.5 * length if i >= 2 else -0.5 * length
        across = 0.5 * width if i % 3 == 0 else -0.5 * width
        corners[i, 0] = pose[0] + along * cosine - across * sine
        corners[i, 1] = pose[1] + along * sine + across * cosine
    return corners


@compiled
def collision(vertices1, vertices2):
    """Return whether the convex hulls of two sets of points, shape (N, 2) each, overlap.

    They overlap if no line through two points of one set separates them.
    """
    for corners in (vertices1, vertices2):
        for i in range(corners.shape[0]):
            for j in range(i + 1, corners.shape[0]):
                x, y = corners[i, 1] - corners[j, 1], corners[j, 0] - corners[i, 0]
                first = x * vertices1[:, 0] + y * vertices1[:, 1]
                second = x * vertices2[:, 0] + y * vertices2[:, 1]
                apart = first.max() <= second.min() or second.max() <= first.min()
                if apart and (x != 0.0 or y != 0.0):
                    return False
    return True


@compiled
def collision_multiple(vertices):
    """Return the overlap (1 or 0) of each of N bodies, shape (N, 4, 2), with any other body.

    Also return the last overlapping body of each; -1 for none.
    """
    count = vertices.shape[0]
    collisions, others = np.zeros(count), -np.ones(count)
    for i in range(count):
        for j in range(i + 1, count):
            if collision(vertices[i], vertices[j]):
                collisions[i] = collisions[j] = 1.0
                others[i], others[j] = j, i
    return collisions, others


@compiled
def get_range(pose, beam_theta, va, vb):
    """Return a beam's range to the segment between two points, m; infinity for a miss.

    The beam's direction is in the world frame.
    """
    x, y, sine, cosine = pose[0] - va[0], pose[1] - va[1], np.sin(beam_theta), np.cos(beam_theta)
    ex, ey = vb[0] - va[0], vb[1] - va[1]
    across = ey * cosine - ex * sine
    if across == 0.0:
        on_line = abs(ex * y - ey * x) < 1e-8
        return min(np.hypot(x, y), np.hypot(x - ex, y - ey)) if on_line else np.inf
    distance, share = (ex * y - ey * x) / across, (y * cosine - x * sine) / across
    return distance if distance >= 0.0 and 0.0 <= share <= 1.0 else np.inf


@compiled
def ray_cast(pose, scan, scan_angles, vertices):
    """Shorten the ranges of a scan, in place, by a car with these corners; return the scan."""
    for i in range(scan.shape[0]):
        for j in range(4):
            found = get_range(pose, pose[2] + scan_angles[i], vertices[j], vertices[(j + 1) % 4])
            scan[i] = min(scan[i], found)
    return scan


@compiled
def check_ttc_jit(scan, vel, scan_angles, cosines, side_distances, ttc_thresh):
    """Return whether a scan predicts a wall hit within a time (s) at a speed (m/s)."""
    for i in range(scan.shape[0]):
        if vel != 0.0 and 0.0 <= (scan[i] - side_distances[i]) / (vel * cosines[i]) < ttc_thresh:
            return True
    return False
