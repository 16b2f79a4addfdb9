"""Parts of a unit sphere beyond planes and edges, as loops without branches."""
from typing import NamedTuple

import numpy as np

from fe_el.compiled.parts import part
from fe_el.coupling.facet_vectors import beside_facet, inside_facets

FAST = {"contract", "reassoc", "nsz", "arcp"}
BALL = 4 * np.pi / 3  # volume of a sphere, in cubed radii
U = np.uint64  # indices without a sign need no test for counting from the end
FOUR = U(4)
RECORD, FIRST, CORNER, MIDDLE = 32, 12, 13, 16  # numbers of a cell; see :func:`fe_el.coupling.overlap.cell_records`
_CORNERS = np.array([13, 19, 22, 25], U)
ENDS = _CORNERS[np.array([[[0, 0], [2, 3], [1, 3], [1, 2]], [[2, 3], [0, 0], [0, 3], [0, 2]],
                          [[1, 3], [0, 3], [0, 0], [0, 1]], [[1, 2], [0, 2], [0, 1], [0, 0]]])]  # of the edge of two facets
INWARDS = 1e-8  # of the way to the middle of its cell: how far centres are moved
TAN_EIGHTH = np.sqrt(2) - 1  # tangent of an eighth of pi


def _arctangent_series(terms=10):
    """Coefficients c of arctan(q) = q (c_0 + c_1 q^2 + ...) up to tan(pi/8), by Chebyshev interpolation: 1e-15."""
    def ratio(z):
        q = np.sqrt(0.5 * TAN_EIGHTH ** 2 * (z + 1))
        return np.arctan(q) / q
    series = np.polynomial.Chebyshev.interpolate(ratio, terms - 1)
    return tuple(series(np.polynomial.Polynomial([-1.0, 2 / TAN_EIGHTH ** 2])).coef.tolist())


C0, C1, C2, C3, C4, C5, C6, C7, C8, C9 = _arctangent_series()


class Notes(NamedTuple):
    """Facets that end inside spheres, and their edges there; what each array holds for one after the other."""

    centre: np.ndarray  #: (4 places,) centre of a sphere [m], as the cell of a place sees it, and one over the radius
    inside: np.ndarray  #: (4 places,) how far it is inside the facets, in radii
    base: np.ndarray  #: (places,) where the record of the cell begins
    cut: np.ndarray  #: (3 facets,) four times the place and the facet, entries that lose and gain what is beyond it
    code: np.ndarray  #: (3 facets,) of an edge: four times the number of the facet and the facet beside
    edge: np.ndarray  #: (6, 3 facets), see :func:`place_edges`


def empty_notes(places):
    """Room for so many places, and for their facets."""
    facets = 4 * places + 4
    return Notes(np.empty(4 * places + 4), np.empty(4 * places), np.empty(places, U), np.empty(3 * facets, U),
                 np.empty(3 * facets, U), np.empty((6, 3 * facets)))


@part(fastmath=FAST, error_model="numpy")
def inwards(cells, cell, x, y, z, radius, centre, at):
    """Note a sphere's centre, moved towards the middle of its cell: to one on an edge its facets would have no direction."""
    record, middle = cells.geometry, cell * U(RECORD) + U(MIDDLE)
    centre[at], centre[at + U(1)] = x + INWARDS * (record[middle] - x), y + INWARDS * (record[middle + U(1)] - y)
    centre[at + U(2)], centre[at + U(3)] = z + INWARDS * (record[middle + U(2)] - z), 1 / radius


@part(fastmath=FAST, error_model="numpy")
def inside_cell(cells, notes, place):
    """Note how far a centre is inside the facets of its cell; returns those that the sphere reaches."""
    record, base, centre, at = cells.geometry, notes.base[place], notes.centre, place * FOUR
    corner = base + U(CORNER)
    x, y, z = record[corner], record[corner + U(1)], record[corner + U(2)]
    point = centre[at] - x, centre[at + U(1)] - y, centre[at + U(2)] - z
    return inside_facets(notes.inside, at, record, base, point, record[base + U(FIRST)], cells.fourth, centre[at + U(3)])


@part(fastmath=FAST, error_model="numpy")
def beside(cells, notes, place, f, h):
    """Edges of facet f, in the cell of a place, that the sphere reaches in its plane, and those that the foot of the centre
    is beyond, by the facets behind them."""
    record, base, other = cells.geometry, notes.base[place], ~(U(17) << f)
    normal = record[base + f], record[base + f + FOUR], record[base + f + U(8)]
    found = beside_facet(notes.inside, place * FOUR, record, base, normal, h) & other
    return found & U(15), found >> FOUR


@part(fastmath=FAST, error_model="numpy")
def _angle(y, x):
    """Angle of the vector (x, y), with y not negative, from the x axis: 0 to pi."""
    a = abs(x)
    large, small = max(a, y), min(a, y)
    fold = small > TAN_EIGHTH * large
    q = (small - large if fold else small) / ((small + large if fold else large) + 1e-300)
    z = q * q
    z2 = z * z
    z4 = z2 * z2
    series = (C0 + C1 * z) + z2 * (C2 + C3 * z) + z4 * ((C4 + C5 * z) + z2 * (C6 + C7 * z) + z4 * (C8 + C9 * z))
    angle = q * series + (0.25 * np.pi if fold else 0.0)
    angle = 0.5 * np.pi - angle if y > a else angle
    return np.pi - angle if x < 0 else angle


@part(fastmath=FAST, error_model="numpy")
def place_edges(cells, notes, number):
    """Fill ``edge``: distances of the plane, and of the edge from the foot of the centre in it times the sine between both
    facets, the square of the sine, where the edge begins and ends from that foot, times its length over the radius, and the
    square of the length. In two dimensions edges are without ends."""
    record, centre, inside, cut, code, edge = cells.geometry, notes.centre, notes.inside, notes.cut, notes.code, notes.edge
    for e in range(number):
        facet, g = cut[code[e] // FOUR * U(3)], code[e] % FOUR
        t, f, h = facet // FOUR, facet % FOUR, inside[facet]
        base, cosine, along, square = notes.base[t], 0.0, 0.0, 0.0
        p, q = base + ENDS[f, g, 0], base + ENDS[f, g, 1]
        for i in range(3):
            side = record[q + U(i)] - record[p + U(i)]
            along += (record[p + U(i)] - centre[t * FOUR + U(i)]) * side
            square += side * side
            cosine += record[base + f + FOUR * U(i)] * record[base + g + FOUR * U(i)]
        edge[0, e], edge[1, e], edge[2, e] = abs(h), inside[t * FOUR + g] - h * cosine, max(1 - cosine * cosine, 1e-30)
        scale, endless = centre[t * FOUR + U(3)], cells.fourth > 0
        edge[3, e], edge[4, e] = -1e30 if endless else along * scale, 1e30 if endless else (along + square) * scale
        edge[5, e] = 1.0 if endless else square


@part(fastmath=FAST, error_model="numpy")
def take_edges(notes, number, weight):
    """Give back what of the part beyond each facet's plane lies beyond its edges: that in the cone through it is left.

    Per edge: the part of a unit sphere beyond a plane at distance h, in the directions between a piece of a line in it and
    farther out. The line is t from the foot of the centre in the plane, the piece lies from ``low`` to ``high`` along it and
    inside the sphere. With R = sqrt(h^2 + t^2 + l^2), the integral of (1 - r^3)/3 over the directions between l = 0 and l is
    (2 arctan(h l, t R) - h (3 - h^2) arctan(l, t) + h t l) / 6; the difference of two arcs is one arc.
    """
    edge, cut, code = notes.edge, notes.cut, notes.code
    for e in range(number):
        h, inside = edge[0, e], edge[1, e] / np.sqrt(edge[2, e])
        t, scale = abs(inside), 1 / np.sqrt(edge[5, e])
        square = h * h + t * t
        half = np.sqrt(max(1 - square, 0.0))
        low, high = max(-half, edge[3, e] * scale), min(half, edge[4, e] * scale)
        high = max(low, high)
        a, b = np.sqrt(square + low * low), np.sqrt(square + high * high)
        arc = _angle(h * t * (high * a - low * b), t * t * a * b + h * h * low * high)
        around = _angle(t * (high - low), t * t + low * high)
        part = (2 * arc - h * (3 - h * h) * around + h * t * (high - low)) / (6 * BALL)
        edge[0, e] = part if inside >= 0 else -part
    for e in range(number):
        at = code[e] // FOUR * U(3)
        weight[cut[at + U(1)]] += edge[0, e]
        weight[cut[at + U(2)]] -= edge[0, e]
