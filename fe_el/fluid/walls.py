"""Walls: the normal part of the velocity held at the nodes, the friction of no-slip walls in the balance (Nitsche's terms).

Nodes that were held at zero would brake every layer thinner than a cell as if the friction coefficient were of order one.
The
weak condition is no-slip where the mesh resolves the layer, and nearly slip where it does not; where drag makes the layer,
or
a wall law knows the friction, that friction acts (Bazilevs & Hughes, Computers & Fluids 36, 2007, 12).
"""
from typing import NamedTuple

import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.direct_calls import Direct
from fe_el.compiled.for_each_dimension import FAST, D, M, by_dimension
from fe_el.fluid.boundary_values import velocity_at

STRENGTH = 4.0  # of Nitsche's penalty, enough for positive definiteness on simplices with lumped facets
SEEN = 0.75  # part of that by which it brakes a layer of drag: drops within 0.5 % of Brinkman's (1: within 1.2 %)
EDGE = 0.1  # square of the sine of half the angle from which two facets of a wall make an edge and not a curve


class Facets(NamedTuple):
    """Facets of all no-slip walls of this rank, behind cells of m = d + 1 nodes."""

    cell: np.ndarray    #: owned cell behind
    local: np.ndarray   #: its vertex opposite the facet
    size: np.ndarray    #: (facets, 3) area, area of each node [m^2], height of the cell above the facet [m]
    slope: np.ndarray   #: (facets, m) normal derivatives of the cell's basis functions [1/m]


@Direct
@njit(fastmath=FAST)
def unresolved_friction(facets, volume, stress, drag, coefficient, out):
    """Add what layers thinner than the cells add to the drag of the cells behind each facet, to ``out`` (cells,) [kg/(m^3
    s)].

    Brinkman's layer, of thickness sqrt(mu/A), has the friction coefficient sqrt(mu A) [Pa s/m] against the velocity outside
    it;
    the cell's own is nearer to the wall's by what the layer takes, so it gets more, x / (1 - x/A). The friction of a wall
    law
    stands in ``coefficient``. What Nitsche's penalty has of either is left out. ``coefficient`` becomes the area times what
    is
    added. What a layer of drag has felt of the penalty, the part SEEN, is measured.
    """
    for f in range(len(facets.cell)):
        c, area = facets.cell[f], facets.size[f, 0]
        resolved = STRENGTH * stress[c] / facets.size[f, 2]
        # smoothing leaves some drag below zero
        layer = max(np.sqrt(stress[c] * max(drag[c], 0.0)) - SEEN * resolved, 0.0)
        if layer > 0.0:
            layer /= 1.0 - layer * area / (drag[c] * volume[c])
        coefficient[f] = max(layer, coefficient[f] - resolved) * area
        out[c] += coefficient[f] / volume[c]


@by_dimension
def add_friction(dofs, entries, facets, stress, consistent, thetas, u, wall, past, rhs):
    """Add -(mu du/dn, w) - (mu dw/dn, u - wall) + (C mu/h (u - wall), w), lumped, to ``entries`` and ``rhs``."""
    place, values = entries.place, entries.values
    for f in range(len(dofs)):
        c, n = facets.cell[f], 0
        a, t = consistent * stress[c] * facets.size[f, 1], thetas[c]
        held, local = STRENGTH * stress[c] / facets.size[f, 2] * facets.size[f, 1], facets.local[f]
        for i in range(M):
            if i == local:
                continue
            for j in range(M):
                part = t * a * facets.slope[f, j]
                values[place[c, i, j]] -= part
                values[place[c, j, i]] -= part
            values[place[c, i, i]] += t * held
            for k in range(D):
                old, rise = u[dofs[f, i], k] - past[f, n, k], 0.0
                for j in range(M):
                    slope = facets.slope[f, j]
                    rise += slope * u[dofs[f, j], k]
                    rhs[dofs[f, j], k] += a * slope * ((1.0 - t) * old - t * wall[f, n, k])
                rhs[dofs[f, i], k] += (1.0 - t) * (a * rise - held * old) + t * held * wall[f, n, k]
            n += 1


@by_dimension
def friction_forces(dofs, facets, stress, consistent, thetas, u, wall, past, new, out):
    """Friction of the fluid on each facet (facets, d) [N], of the same terms, for the velocities ``u`` before and ``new``
    after."""
    for f in range(len(dofs)):
        c, n = facets.cell[f], 0
        a, t = consistent * stress[c] * facets.size[f, 0], thetas[c]
        held, local = STRENGTH * stress[c] / facets.size[f, 2] * facets.size[f, 1], facets.local[f]
        for k in range(D):
            out[f, k] = 0.0
        for i in range(M):
            for k in range(D):
                now, before = new[dofs[f, i], k], u[dofs[f, i], k]
                out[f, k] -= a * facets.slope[f, i] * (t * now + (1.0 - t) * before)
                if i != local:
                    out[f, k] += held * (t * (now - wall[f, n, k]) + (1.0 - t) * (before - past[f, n, k]))
            n += i != local


def held_directions(fluid, walls):
    """Directions in which walls hold their nodes: orthonormal, one or more for each node.

    Args:
        fluid: with its nodes and their exchange.
        walls: list of BoundaryFacets.

    Returns:
        nodes that have a direction free (one entry for each direction), the directions (entries, d), and nodes without any.
        The first direction of a node is that of its facets' area vectors, which fits the balance of mass; where its facets
        meet at an edge or corner there are others.

    Note:
        Collective.
    """
    d = fluid.dimension
    vector, tensor, area = fluid.nodal_zeros((d,)), fluid.nodal_zeros((d * d,)), fluid.nodal_zeros((1,))
    for facets in walls:
        size = np.linalg.norm(facets.area_normal, axis=1)
        spread = facets.area_normal[:, :, None] * facets.area_normal[:, None, :] / np.maximum(size, 1e-300)[:, None, None]
        np.add.at(vector, facets.facet_nodes, facets.area_normal[:, None])
        np.add.at(tensor, facets.facet_nodes, spread.reshape(-1, 1, d * d))
        np.add.at(area, facets.facet_nodes, size[:, None, None])
    fluid.node_halo.complete(vector, tensor, area)
    at = np.flatnonzero(area[:, 0])
    tensor = tensor[at].reshape(-1, d, d) / area[at][:, :, None]
    direction = vector[at] / area[at]
    nodes, directions, count = [], [], np.zeros(len(at), int)
    for k in range(d):
        length = np.linalg.norm(direction, axis=1)
        there = (length ** 2 > EDGE) if k else length > 1e-6
        unit = direction / np.maximum(length, 1e-300)[:, None]
        nodes.append(np.flatnonzero(there))
        directions.append(unit[there])
        count += there
        off = np.where(there[:, None, None], np.eye(d) - unit[:, :, None] * unit[:, None, :], np.eye(d))
        tensor = off @ tensor @ off
        values, vectors = np.linalg.eigh(tensor)
        direction = np.sqrt(np.maximum(values[:, -1], 0.0))[:, None] * vectors[:, :, -1]
    nodes, directions = np.concatenate(nodes), np.concatenate(directions)
    free = count[nodes] < d
    return at[nodes[free]], np.ascontiguousarray(directions[free]), at[count == d]


class WallFriction:
    """Friction of the no-slip walls of a fluid: part of the balance that its transport solves, and of the drag in its cells.

    Args:
        fluid (VolumeAveragedNavierStokes): the fluid.
        walls: list of (BoundaryFacets, velocity or None, law or None).
    """

    def __init__(self, fluid, walls):
        self.fluid, self.walls, d = fluid, walls, fluid.dimension
        none = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, d)))]
        cell, local, vector = (np.concatenate(a)
                               for a in zip(*(none + [(f.cell, f.local, f.area_normal) for f, _, _ in walls])))
        area = np.linalg.norm(vector, axis=1)
        self.normal = vector / area[:, None]
        self.facets = Facets(cell, local, np.column_stack([area, area / d, d * fluid.volume[cell] / area]),
                             np.einsum("fik,fk->fi", fluid.gradient[cell], self.normal))
        self.dofs = np.ascontiguousarray(fluid.dofs[cell])
        ends = np.cumsum([0] + [len(f.cell) for f, _, _ in walls])
        self.rows = [slice(a, b) for a, b in zip(ends, ends[1:])]
        self.changes = any(callable(v) for _, v, _ in walls)
        self.moves = any(v is not None for _, v, _ in walls)
        self.velocity, self.force = np.zeros((len(cell), d, d)), np.zeros((len(cell), d))
        self.coefficient = np.zeros(len(cell))
        self._set_velocity(fluid.time)
        self.past = self.velocity.copy()

    def _set_velocity(self, time):
        """Velocities of the walls at the nodes of their facets."""
        d = self.fluid.dimension
        for (facets, value, _), rows in zip(self.walls, self.rows):
            if value is not None:
                at = self.fluid.node_position[facets.facet_nodes].reshape(-1, 3)
                self.velocity[rows] = velocity_at(value, time, at, d).reshape(-1, d, d)

    def add(self, step, thetas, matrix, rhs):
        """Add the terms of the step that ends now, of implicit part ``thetas`` (cells,), to a NodalMatrix and to the nodal
        right-hand side (nodes, d)."""
        air = self.fluid
        if self.changes:
            self.past[:] = self.velocity
            self._set_velocity(air.time)
        self._last = (self.facets, step.stress, 0.0 if air.upwind else 1.0, thetas, step.nodal_velocity, self.velocity,
                      self.past)
        add_friction(self.dofs, matrix.entries, *self._last, rhs)

    def close(self, new):
        """Keep the forces on the facets that the solution of transport gives."""
        friction_forces(self.dofs, *self._last, new, self.force)

    def in_cells(self, step):
        """Drag coefficient and source with the friction of layers that the mesh does not resolve, for the velocities
        before."""
        air, d, source, q = self.fluid, self.fluid.dimension, step.source, step.velocity
        for (wall, _, law), rows in zip(self.walls, self.rows):
            if law is None:
                self.coefficient[rows] = 0.0
                continue
            normal, slip = self.normal[rows], q[wall.cell] - self.velocity[rows].mean(1)
            speed = np.linalg.norm(slip - (slip * normal).sum(1)[:, None] * normal, axis=1)
            self.coefficient[rows] = law(speed, self.facets.size[rows, 2] / (d + 1), air.density, air.viscosity)
        whole = air.work.empty("drag_with_walls", air.num_cells)
        whole[:] = step.drag
        unresolved_friction(self.facets, air.volume, step.stress, step.drag, self.coefficient, whole)
        if self.moves and self.coefficient.any():
            pull = self.coefficient[:, None] * self.velocity.mean(1) / air.volume[self.facets.cell, None]
            source = source.copy()
            np.add.at(source, self.facets.cell, pull)
        return whole, source

    def force_on(self, facets):
        """Friction on the wall with these facets, this rank's part (d,) [N]."""
        air, d = self.fluid, self.fluid.dimension
        q = air.velocity.x.array.reshape(-1, d)
        total = np.zeros(d)
        for (wall, _, _), rows in zip(self.walls, self.rows):
            if wall is facets:
                total += self.force[rows].sum(0)
                total += self.coefficient[rows] @ (q[wall.cell] - self.velocity[rows].mean(1))
        return total
