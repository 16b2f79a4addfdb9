"""Parts of a unit sphere beyond planes and edges, as loops without branches."""
import numpy as np

from fe_el.compiled.parts import part

FAST = {"contract", "reassoc", "nsz", "arcp"}
BALL = 4 * np.pi / 3  # volume of a sphere, in cubed radii
U = np.uint64  # indices without a sign need no test for counting from the end
ENDS = np.array([[[0, 0], [2, 3], [1, 3], [1, 2]], [[2, 3], [0, 0], [0, 3], [0, 2]],
                 [[1, 3], [0, 3], [0, 0], [0, 1]], [[1, 2], [0, 2], [0, 1], [0, 0]]], U)  # vertices of the edge of a pair
TAN_EIGHTH = np.sqrt(2) - 1  # tangent of an eighth of pi


def _arctangent_series(terms=10):
    """Coefficients c of arctan(q) = q (c_0 + c_1 q^2 + ...) up to tan(pi/8), by Chebyshev interpolation: 1e-15."""
    def ratio(z):
        q = np.sqrt(0.5 * TAN_EIGHTH ** 2 * (z + 1))
        return np.arctan(q) / q
    series = np.polynomial.Chebyshev.interpolate(ratio, terms - 1)
    return tuple(series(np.polynomial.Polynomial([-1.0, 2 / TAN_EIGHTH ** 2])).coef.tolist())


C0, C1, C2, C3, C4, C5, C6, C7, C8, C9 = _arctangent_series()


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
def place_edges(corner, notes, number):
    """Complete ``edge``: distances of the plane, and of the edge from the foot of the centre, where it begins and ends from
    there, times its length over the radius, and the square of the length."""
    geometry, cut, code, edge = notes.geometry, notes.cut, notes.code, notes.edge
    for e in range(number):
        k, g = code[e] >> U(2), code[e] & U(3)
        c, f = cut[k, 0] >> U(2), cut[k, 0] & U(3)
        edge[0, e], edge[2, e], edge[3, e], edge[4, e] = geometry[k, 0], -1e30, 1e30, 1.0
        if corner.shape[1] == 4:
            p, q, along, square = ENDS[f, g, 0], ENDS[f, g, 1], 0.0, 0.0
            for i in range(3):
                side = corner[c, q, i] - corner[c, p, i]
                along += (corner[c, p, i] - geometry[k, 1 + i]) * side
                square += side * side
            edge[2, e], edge[3, e], edge[4, e] = along * geometry[k, 4], (along + square) * geometry[k, 4], square


@part(fastmath=FAST, error_model="numpy")
def take_edges(edge, cut, code, number, weight):
    """Give back what of the part beyond each facet's plane lies beyond its edges: that in the cone through it is left.

    Per edge: the part of a unit sphere beyond a plane at distance h, in the directions between a piece of a line in it and
    farther out. The line is t from the foot of the centre in the plane, the piece lies from ``low`` to ``high`` along it and
    inside the sphere. With R = sqrt(h^2 + t^2 + l^2), the integral of (1 - r^3)/3 over the directions between l = 0 and l is
    (2 arctan(h l, t R) - h (3 - h^2) arctan(l, t) + h t l) / 6; the difference of two arcs is one arc.
    """
    for e in range(number):
        h, inside = edge[0, e], edge[1, e]
        t, scale = abs(inside), 1 / np.sqrt(edge[4, e])
        square = h * h + t * t
        half = np.sqrt(max(1 - square, 0.0))
        low, high = max(-half, edge[2, e] * scale), min(half, edge[3, e] * scale)
        high = max(low, high)
        a, b = np.sqrt(square + low * low), np.sqrt(square + high * high)
        arc = _angle(h * t * (high * a - low * b), t * t * a * b + h * h * low * high)
        around = _angle(t * (high - low), t * t + low * high)
        part = (2 * arc - h * (3 - h * h) * around + h * t * (high - low)) / (6 * BALL)
        edge[0, e] = part if inside >= 0 else -part
    for e in range(number):
        k = code[e] >> U(2)
        weight[cut[k, 1]] += edge[0, e]
        weight[cut[k, 2]] -= edge[0, e]
