"""Locating points on unstructured simplices: walk through facets, then vertex neighbours, then a search of all cells."""
import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.parts import part
from fe_el.particles.contacts.neighbours import morton_code

INSIDE = 0.0  # the cells' maps are moved a little, so that a point on a facet belongs to one cell
AT_BOUNDARY = -1e-8  # a point on the boundary counts as inside
MANY = 50_000  # particles, from which cells of particles in any order no longer stay in the caches


@part
def lowest_coordinate(barycentric, cell, x, y, z):
    """Facet with the lowest barycentric coordinate of a point, and that coordinate."""
    facet, lowest = 0, 1e300
    for f in range(barycentric.shape[1]):
        b = barycentric[cell, f]
        value = b[0] * x + b[1] * y + b[2] * z + b[3]
        if value < lowest:
            facet, lowest = f, value
    return facet, lowest


@njit
def walk(barycentric, neighbour, shift, cell, point, limit):
    """Walk from ``cell`` towards ``point`` (shifted in place across periodic facets): the cell, or -1 at the boundary."""
    for _ in range(limit):
        facet, lowest = lowest_coordinate(barycentric, cell, point[0], point[1], point[2])
        if lowest >= INSIDE:
            return cell
        target = neighbour[cell, facet]
        if target < 0 and lowest >= AT_BOUNDARY:
            inner = True
            for f in range(barycentric.shape[1]):
                b = barycentric[cell, f]
                inner &= neighbour[cell, f] < 0 or b[0] * point[0] + b[1] * point[1] + b[2] * point[2] + b[3] >= INSIDE
            if inner:
                return cell
        if target < 0:  # try another way round before giving up
            for f in range(barycentric.shape[1]):
                b = barycentric[cell, f]
                if neighbour[cell, f] >= 0 and b[0] * point[0] + b[1] * point[1] + b[2] * point[2] + b[3] < INSIDE:
                    target, facet = neighbour[cell, f], f
                    break
            if target < 0:
                return -1
        if len(shift):
            for k in range(3):
                point[k] += shift[cell, facet, k]
        cell = target
    return -1


@njit
def locate_from(barycentric, neighbour, shift, vertex_start, vertex_cells, local_vertex, cell, position):
    """Update ``cell`` for every position, in place; -1 where neither the walk nor the vertex neighbours find it."""
    missing, old = 0, np.empty(3)
    for i in range(len(cell)):
        first = cell[i]
        if lowest_coordinate(barycentric, first, position[i, 0], position[i, 1], position[i, 2])[1] >= INSIDE:
            continue
        old[:] = position[i]
        cell[i] = walk(barycentric, neighbour, shift, first, position[i], 2000)
        if cell[i] < 0:
            position[i] = old
            for v in local_vertex[first]:
                for k in range(vertex_start[v], vertex_start[v + 1]):
                    c = vertex_cells[k]
                    if cell[i] < 0 and not len(shift) and \
                            lowest_coordinate(barycentric, c, old[0], old[1], old[2])[1] >= AT_BOUNDARY:
                        cell[i] = c
            missing += cell[i] < 0
    return missing


def curve_through(cells):
    """Ranks (cells,) of the cells along a Morton curve through their middles, and how far they reach [m]."""
    middle = cells.corner.mean(1)
    reach = np.ptp(cells.corner, 1).max(1).mean() if len(middle) else 1.0
    rank = np.empty(len(middle), np.int32)
    rank[np.argsort(morton_code(middle, middle.min(0, initial=np.inf), 0.5 * reach), kind="stable")] = np.arange(len(middle))
    return rank, reach


@njit
def order_by_cell(cell, position, curve):
    """Rows of the particles cell by cell along the curve; none if most are less than four cells from the one before them."""
    far, (rank, reach) = 0, curve
    for i in range(1, len(cell)):
        square = 0.0
        for k in range(3):
            square += (position[i, k] - position[i - 1, k]) ** 2
        far += square > 16 * reach * reach
    if 4 * far < len(cell):
        return np.empty(0, np.int32)
    start, order = np.zeros(len(rank) + 1, np.int32), np.empty(len(cell), np.int32)
    for c in cell:
        start[rank[c] + 1] += 1
    for c in range(len(rank)):
        start[c + 1] += start[c]
    for i in range(len(cell)):
        c = rank[cell[i]]
        order[start[c]] = i
        start[c] += 1
    return order


@njit
def _fill_bins(corner, lower, size, shape, start, content, count_only):
    """Bin the cells by their bounding boxes: count, or fill ``content``."""
    for c in range(len(corner)):
        lo = np.zeros(3, np.int64)
        hi = np.zeros(3, np.int64)
        for k in range(3):
            lo[k] = min(max(int((corner[c, :, k].min() - lower[k]) / size), 0), shape[k] - 1)
            hi[k] = min(max(int((corner[c, :, k].max() - lower[k]) / size), 0), shape[k] - 1)
        for i in range(lo[0], hi[0] + 1):
            for j in range(lo[1], hi[1] + 1):
                for k in range(lo[2], hi[2] + 1):
                    b = (i * shape[1] + j) * shape[2] + k
                    if count_only:
                        start[b + 1] += 1
                    else:
                        content[start[b]] = c
                        start[b] += 1


@njit
def _search(barycentric, owned, lower, size, shape, start, content, position):
    """Owned cell of every position, or -1."""
    cell = np.full(len(position), -1, np.int32)
    for i in range(len(position)):
        b = 0
        for k in range(3):
            index = int(np.floor((position[i, k] - lower[k]) / size))
            if index == shape[k] and position[i, k] - lower[k] <= shape[k] * size * (1 + 1e-12):
                index -= 1
            if index < 0 or index >= shape[k]:
                b = -1
                break
            b = b * shape[k] + index
        if b >= 0:
            best = AT_BOUNDARY
            for k in range(start[b], start[b + 1]):
                c = content[k]
                lowest = lowest_coordinate(barycentric, c, position[i, 0], position[i, 1], position[i, 2])[1]
                if c < owned and lowest > best and best < INSIDE:
                    cell[i], best = c, lowest
    return cell


class CellSearch:
    """Finds the owned cell of any point, without a guess, by bins of the cells' bounding boxes."""

    def __init__(self, cells):
        self.cells = cells
        corner = cells.corner
        self.lower = corner.min((0, 1)) - 1e-9 * np.ptp(corner, (0, 1)).max()
        extent = corner.max((0, 1)) - self.lower
        self.size = 1.5 * np.ptp(corner, 1).max(1).mean() + 1e-300
        self.shape = np.maximum(np.ceil(extent / self.size).astype(np.int64), 1)
        start = np.zeros(self.shape.prod() + 1, np.int64)
        _fill_bins(corner, self.lower, self.size, self.shape, start, np.empty(0, np.int32), True)
        start = np.cumsum(start)
        self.content = np.empty(start[-1], np.int32)
        filled = start.copy()
        _fill_bins(corner, self.lower, self.size, self.shape, filled, self.content, False)
        self.start = start

    def __call__(self, position):
        """Owned cell of each position (points, 3), or -1."""
        return _search(self.cells.barycentric, self.cells.owned, self.lower, self.size, self.shape, self.start,
                       self.content, np.ascontiguousarray(position, np.float64))


def locate(cells, cell, position):
    """Update the cells of positions in place, starting from the last ones; return how many were not found."""
    return locate_from(cells.barycentric, cells.neighbour, cells.shift, cells.vertex_start, cells.vertex_cells,
                       cells.local_vertex, cell, position)
