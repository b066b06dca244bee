"""Compiled functions for occupancy grids: distance to walls, exact rays, nearest points, way out.

Grids are indexed ``[row, column]`` with row 0 at the bottom, so cell ``[i, j]`` covers ``origin +
resolution * ([j, j + 1], [i, i + 1])``. They are bool arrays of shape (H, W); the outermost rows
and columns of a ``drivable`` grid must be False. Points ``x, y`` are in cells from the grid's lower
left corner.
"""

import heapq

import numpy as np

from pcs_racing.base.compilation import compiled


@compiled
def distance_to_walls(drivable, cell):
    """Return the exact distance from each drivable cell's centre to the nearest other cell.

    In m for cells with the side ``cell``, float32; to the nearest point of the other cell's square,
    so the minimum is half a cell; 0 on all non-drivable cells. Two passes after Felzenszwalb and
    Huttenlocher, "Distance Transforms of Sampled Functions" (2012), with the parabolas rooted at
    cell faces instead of cell centres.
    """
    height, width = drivable.shape
    out = np.empty((height, width), dtype=np.float32)
    out[:] = 0.0
    # Along each column, in cells, to the nearest horizontal wall face.
    for i in range(1, height):
        for j in range(width):
            if drivable[i, j]:
                out[i, j] = out[i - 1, j] + 1.0 if drivable[i - 1, j] else 0.5
    for i in range(height - 2, -1, -1):
        for j in range(width):
            if drivable[i, j]:
                out[i, j] = min(out[i, j], out[i + 1, j] + 1.0 if drivable[i + 1, j] else 0.5)
    # Along each row: lower envelope of the parabolas (x - q)^2 + height^2 at faces q = j + 1/2.
    root = np.empty(width)
    squared = np.empty(width)
    begin = np.empty(width + 1)
    column = np.empty(width)
    for i in range(height):
        for j in range(width):
            column[j] = out[i, j]
        top = -1
        for j in range(width - 1):
            low = min(column[j], column[j + 1])
            q = j + 0.5
            value = low * low + q * q
            # A parabola undercut by the new parabola before its own stretch is never minimal.
            while top >= 0:
                cross = (value - squared[top] - root[top] * root[top]) / (2.0 * (q - root[top]))
                if cross > begin[top]:
                    break
                top -= 1
            top += 1
            root[top] = q
            squared[top] = low * low
            begin[top] = cross if top > 0 else -1.0
        begin[top + 1] = width
        k = 0
        for j in range(width):
            while begin[k + 1] < j:
                k += 1
            if column[j] > 0.0:
                across = (j - root[k]) ** 2 + squared[k]
                out[i, j] = np.sqrt(min(column[j] * column[j], across)) * cell
    return out


@compiled
def cast(drivable, x, y, cos, sin, reach):
    """Follow a ray by cells to the first face of a non-drivable cell (Amanatides and Woo, 1987).

    Returns the distance in cells, at most ``reach``; row and column of the last drivable cell (the
    start's cell if not drivable); and the side of that cell crossed by the ray: 0 bottom, 1 right,
    2 top, 3 left, -1 without a wall.
    """
    height, width = drivable.shape
    i = int(np.floor(y))
    j = int(np.floor(x))
    if i < 0 or j < 0 or i >= height or j >= width or not drivable[i, j]:
        return 0.0, i, j, -1
    di = 1 if sin > 0.0 else -1
    dj = 1 if cos > 0.0 else -1
    step_x = 1.0 / abs(cos) if cos != 0.0 else np.inf
    step_y = 1.0 / abs(sin) if sin != 0.0 else np.inf
    next_x = (j + 1 - x if dj > 0 else x - j) * step_x if cos != 0.0 else np.inf
    next_y = (i + 1 - y if di > 0 else y - i) * step_y if sin != 0.0 else np.inf
    # The loop ends at the latest in the outermost cells, which are never drivable.
    while True:
        if next_x < next_y:
            if next_x >= reach:
                return reach, i, j, -1
            if not drivable[i, j + dj]:
                return next_x, i, j, 1 if dj > 0 else 3
            j += dj
            next_x += step_x
        else:
            if next_y >= reach:
                return reach, i, j, -1
            if not drivable[i + di, j]:
                return next_y, i, j, 2 if di > 0 else 0
            i += di
            next_y += step_y


@compiled
def _push_neighbours(queue, mask, label, x, y, i, j):
    height, width = mask.shape
    k = np.int64(label[i, j])
    for side in range(4):
        ni = i + (side == 2) - (side == 0)
        nj = j + (side == 1) - (side == 3)
        if 0 <= ni < height and 0 <= nj < width and mask[ni, nj] and label[ni, nj] < 0:
            near = (x[k] - nj - 0.5) ** 2 + (y[k] - ni - 0.5) ** 2
            heapq.heappush(queue, (near, np.int64(ni * width + nj), k))


@compiled
def spread_labels(mask, label, x, y):
    """Label every cell of the region ``mask`` in place with the number of a near point.

    A label (int32; -1 is none) spreads from a labelled cell to its four neighbours in the region,
    the nearest point first. So a cell next to a thin wall gets a point on its own side of the wall,
    even if a point on the other side is nearer. Unreached cells remain -1.
    """
    height, width = mask.shape
    # An empty list has no type for numba: an element sets the type.
    queue = [(0.0, np.int64(0), np.int64(0))]
    queue.pop()
    for i in range(height):
        for j in range(width):
            if label[i, j] >= 0:
                _push_neighbours(queue, mask, label, x, y, i, j)
    while len(queue) > 0:
        _, at, k = heapq.heappop(queue)
        i, j = divmod(at, width)
        # A cell is queued once per neighbour that reached it; the first entry out is the nearest.
        if label[i, j] < 0:
            label[i, j] = k
            _push_neighbours(queue, mask, label, x, y, i, j)


@compiled
def lookup_grid(drivable, x, y, block):
    """Return the number of each block's nearest point, measured without crossing walls.

    The points, all on drivable cells, have numbers from 0. A block has ``block`` cells along its
    side and gets the point of the drivable cell nearest to its centre. Blocks without a drivable
    cell get the number of a neighbouring block.
    """
    height, width = drivable.shape
    label = np.full((height, width), -1, dtype=np.int32)
    for k in range(x.shape[0]):
        label[int(np.floor(y[k])), int(np.floor(x[k]))] = k
    spread_labels(drivable, label, x, y)
    rows = (height + block - 1) // block
    cols = (width + block - 1) // block
    out = np.full((rows, cols), -1, dtype=np.int32)
    for a in range(rows):
        for b in range(cols):
            best = np.inf
            for i in range(a * block, min((a + 1) * block, height)):
                for j in range(b * block, min((b + 1) * block, width)):
                    away = (i + 0.5 - (a + 0.5) * block) ** 2 + (j + 0.5 - (b + 0.5) * block) ** 2
                    if label[i, j] >= 0 and away < best:
                        best = away
                        out[a, b] = label[i, j]
    spread_labels(np.ones((rows, cols), dtype=np.bool_), out, x / block, y / block)
    return out


@compiled
def way_out(occupied, rows, cols):
    """Return the shortest path over free cells from seeds to the grid's border or farthest cell.

    Seeds are free cells (rows[k], cols[k]). The path goes to the farthest cell if the border is
    unreachable; it has the rows and columns of its cells, shape (K, 2), its end first.
    """
    height, width = occupied.shape
    parent = np.full((height, width), -2, dtype=np.int32)
    queue = np.empty(height * width, dtype=np.int32)
    size = 0
    for k in range(rows.shape[0]):
        if parent[rows[k], cols[k]] == -2:
            parent[rows[k], cols[k]] = -1
            queue[size] = rows[k] * width + cols[k]
            size += 1
    at = 0
    cell = np.int64(queue[0])
    while at < size:
        cell = np.int64(queue[at])
        at += 1
        i, j = divmod(cell, width)
        # Breadth first: the first border cell ends a shortest path.
        if i == 0 or j == 0 or i == height - 1 or j == width - 1:
            break
        for side in range(4):
            ni = i + (side == 2) - (side == 0)
            nj = j + (side == 1) - (side == 3)
            if parent[ni, nj] == -2 and not occupied[ni, nj]:
                parent[ni, nj] = cell
                queue[size] = ni * width + nj
                size += 1
    way = [cell]
    while parent[cell // width, cell % width] >= 0:
        cell = np.int64(parent[cell // width, cell % width])
        way.append(cell)
    out = np.empty((len(way), 2), dtype=np.int64)
    for k in range(len(way)):
        out[k, 0] = way[k] // width
        out[k, 1] = way[k] % width
    return out


def at_cell(row: int, col: int, height: int, resolution: float, corner: np.ndarray) -> str:
    """Return the place of a cell as text: in m, and as the pixel from the top left."""
    x, y = corner + resolution * (np.array([col, row]) + 0.5)
    return f"({x:.2f}, {y:.2f}) m, pixel ({col}, {height - 1 - row})"
