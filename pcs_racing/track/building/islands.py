"""Islands in a free region: the infield of a track, and dirt and obstacles, which are filled."""

import numpy as np

SPECK = 0.5  # holes of less area are dirt or obstacles on the track, m^2 ...
ISLAND = 0.25  # ... and also holes of less than this share of the max hole extent


def fill_islands(
    region: np.ndarray, resolution: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a region with filled islands (dirt, obstacles), and its holes.

    The holes are labelled in an array; the numbers of the large holes are returned too. The
    outermost rows and columns of the region are False; they belong to no hole.
    """
    from scipy import ndimage

    # The region is connected by sides, so its surroundings are connected by corners too.
    holes, count = ndimage.label(~region, structure=np.ones((3, 3)))
    sizes = np.bincount(holes.ravel(), minlength=count + 1) * resolution**2
    extent = np.array(
        [0, *(max(part.stop - part.start for part in box) for box in ndimage.find_objects(holes))]
    )
    outside = int(holes[0, 0])
    sizes[[0, outside]] = extent[[0, outside]] = 0
    large = np.flatnonzero((sizes >= SPECK) & (extent >= ISLAND * extent.max()))
    return region | ((holes != outside) & ~np.isin(holes, large)), holes, large
