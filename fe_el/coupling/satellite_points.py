"""Satellite points: the share w_ij of particle i in cell j from 29 points inside it."""
from typing import NamedTuple

import numpy as np
from numba import njit

from fe_el.particles.location import INSIDE, walk

INNER, OUTER = 0.6276065, 0.9085281  # centroids of two shells that share the sphere's volume, in radii


class Shares(NamedTuple):
    """Cells and weights of every particle: entries start[i]:start[i+1] belong to particle i and sum to one."""

    start: np.ndarray
    cell: np.ndarray
    weight: np.ndarray


def isotropic_points():
    """Centre, 6 axes and 8 cube corners at two radii: (29, 3), in radii. Second moments are nearly isotropic."""
    axes = np.vstack([np.eye(3), -np.eye(3)])
    corners = np.array([(a, b, c) for a in (1, -1) for b in (1, -1) for c in (1, -1)]) / np.sqrt(3)
    directions = np.vstack([axes, corners])
    return np.vstack([np.zeros((1, 3)), INNER * directions, OUTER * directions])


def centre_point():
    """The particle's centre alone: (1, 3)."""
    return np.zeros((1, 3))


@njit(cache=True)
def _shares(barycentric, neighbour, shift, cell, position, radius, points, start, cells, weights):
    """Fill the shares; points outside the domain do not count."""
    number, here = 0, np.empty(3)
    m = barycentric.shape[1]
    for i in range(len(cell)):
        start[i] = number
        c, inside = cell[i], True
        for f in range(m):  # distance to facet f over the height there is the barycentric coordinate
            b = barycentric[c, f]
            value = b[0] * position[i, 0] + b[1] * position[i, 1] + b[2] * position[i, 2] + b[3]
            inside &= value >= radius[i] * np.sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2])
        if inside or len(points) == 1:
            cells[number], weights[number] = c, 1.0
            number += 1
            continue
        found = 0
        for s in range(len(points)):
            for k in range(3):
                here[k] = position[i, k] + radius[i] * points[s, k]
            target, low = c, 0.0
            for f in range(m):
                b = barycentric[c, f]
                low = min(low, b[0] * here[0] + b[1] * here[1] + b[2] * here[2] + b[3])
            if low < INSIDE:
                target = walk(barycentric, neighbour, shift, c, here, 100)
            if target < 0:
                continue
            found += 1
            for k in range(start[i], number + 1):
                if k == number:
                    cells[number], weights[number] = target, 1.0
                    number += 1
                    break
                if cells[k] == target:
                    weights[k] += 1.0
                    break
        for k in range(start[i], number):
            weights[k] /= found
    start[len(cell)] = number
    return number


def shares(cells, cell, position, radius, points):
    """Shares of particles at ``position`` with centre in ``cell``."""
    n = len(cell)
    start = np.empty(n + 1, np.int64)
    index, weight = np.empty(n * len(points), np.int32), np.empty(n * len(points))
    number = _shares(cells.barycentric, cells.neighbour, cells.shift, cell, position, radius, points, start, index, weight)
    return Shares(start, index[:number], weight[:number])


@njit(cache=True)
def deposit(start, cell, weight, quantity, out):
    """out[j] += sum_i w_ij quantity_i for (particles, k) quantities."""
    for i in range(len(start) - 1):
        for n in range(start[i], start[i + 1]):
            for k in range(quantity.shape[1]):
                out[cell[n], k] += weight[n] * quantity[i, k]


@njit(cache=True)
def gather(start, cell, weight, field, out):
    """out[i] = sum_j w_ij field_j for (cells, k) fields."""
    for i in range(len(start) - 1):
        for k in range(field.shape[1]):
            total = 0.0
            for n in range(start[i], start[i + 1]):
                total += weight[n] * field[cell[n], k]
            out[i, k] = total
