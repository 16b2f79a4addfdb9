"""Points of a mesh found again by their places, on whatever rank."""
import numpy as np


def nearest(points, wanted, period):
    """Index of the point at each wanted place, and whether there is one within a millionth of the mesh; periodic boxes
    wrap."""
    from scipy.spatial import cKDTree  # where a checkpoint is loaded, nowhere else
    if not len(points) or not len(wanted):
        return np.zeros(len(wanted), np.int64), np.zeros(len(wanted), bool)
    size, box = np.ptp(points, 0).max() + np.abs(points).max(), None
    if period is not None and np.any(period):
        box = np.asarray(period, float)
        points, wanted = (np.where(box > 0, x - np.floor(x / np.where(box > 0, box, 1)) * box, x) for x in (points, wanted))
        points, wanted = (np.where((box > 0) & (x >= box), 0.0, x) for x in (points, wanted))
        lower = np.where(box > 0, 0.0, np.minimum(points.min(0), wanted.min(0)))  # the tree wants no negative places
        points, wanted = points - lower, wanted - lower
    distance, index = cKDTree(points, boxsize=box).query(wanted, distance_upper_bound=1e-6 * size)
    found = np.isfinite(distance)
    return np.where(found, index, 0), found
