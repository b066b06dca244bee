"""Reasons for a grid without a closed loop of track, each with its place and the remedy."""

import numpy as np

from pcs_racing.track.building.islands import fill_islands
from pcs_racing.track.grid import at_cell

GAPS = (1, 2, 3, 5, 8, 12, 18, 27, 40)  # half widths of gaps to search for, in cells


def find_gap(
    grid: np.ndarray, region: np.ndarray, resolution: float, corner: np.ndarray, share: float = 1.0
) -> str:
    """Return a text about the gap that makes a free region more than a ring; empty without a gap.

    Growing walls close gaps: a leaking track becomes a ring of at most a ``share`` of the free
    cells.
    """
    from scipy import ndimage

    from pcs_racing.track.grid import way_out  # imports numba, which names of tracks do without

    room = ndimage.distance_transform_edt(~grid)
    for half in GAPS:
        parts, count = ndimage.label(region & (room > half))
        sizes = np.bincount(parts.ravel(), minlength=count + 1)
        edge = np.unique(np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]]))
        for k, (rows, cols) in enumerate(ndimage.find_objects(parts), start=1):
            if k in edge or min(rows.stop - rows.start, cols.stop - cols.start) * resolution < 2.0:
                continue
            ring = np.pad(parts[rows, cols] == k, 1)
            if sizes[k] > share * sizes[1:].sum() or len(fill_islands(ring, resolution)[2]) != 1:
                continue
            way = way_out(grid, *np.nonzero(parts == k))[::-1]
            free = room[way[:, 0], way[:, 1]]
            free[(way % (np.array(grid.shape) - 1) == 0).any(axis=1)] = np.inf
            wide = np.flatnonzero(free[1:] > half)  # beyond the gap
            i, j = way[int(np.argmin(free[: wide[0] + 1] if len(wide) else free))]
            return (
                f"the wall has a gap of up to {2 * half * resolution:.1f} m near "
                f"{at_cell(i, j, len(grid), resolution, corner)}; close it in the picture"
            )
    return ""


def no_loop(
    grid: np.ndarray, resolution: float, corner: np.ndarray, seed: np.ndarray | None
) -> str:
    """Return the message for a grid without a free ring (at the seed point, if any)."""
    from scipy import ndimage

    if grid.all() or not grid.any():
        return (
            f"no closed loop found: the picture has no {'free cell' if grid.all() else 'wall'};"
            " check its thresholds"
        )
    labels, _ = ndimage.label(~grid)
    border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    region, where, several = labels > 0, "the picture", ~np.isin(labels, border)
    if seed is not None:
        col, row = np.floor((seed - corner) / resolution).astype(int)
        region = several = labels == labels[row, col]
        where = f"the free region at seed point ({seed[0]:g}, {seed[1]:g})"
    gap = find_gap(grid, region, resolution, corner)
    if gap:
        return f"no closed loop found: {gap}"
    for k, box in enumerate(ndimage.find_objects(np.where(several, labels, 0)), start=1):
        if box is None:
            continue
        rows, cols = box
        _, holes, large = fill_islands(np.pad(labels[rows, cols] == k, 1), resolution)
        if len(large) > 1:
            # The nearest place to the two largest holes: a crossing of lines, or near an obstacle.
            first, second = sorted(large, key=lambda hole: -np.count_nonzero(holes == hole))[:2]
            away = [ndimage.distance_transform_edt(holes != hole) for hole in (first, second)]
            i, j = np.unravel_index(
                np.argmin(np.where(holes == 0, np.maximum(*away), np.inf)), holes.shape
            )
            place = at_cell(i + rows.start - 1, j + cols.start - 1, len(grid), resolution, corner)
            return (
                f"{where} has no single loop: it surrounds {len(large)} islands, and crosses itself"
                f" or branches near {place}: close all ways but one by walls, and remove large"
                " obstacles"
            )
    return (
        f"{where} has no closed loop: no free region lies between one inner and one outer wall"
        " (walls are the cells darker than the threshold; one may lie across the track)"
    )
