"""Numba loops of :class:`MultiphasePIC`: particles to nodes by the hat functions N_v, the stress at the nodes, and back.

Node v holds the volume sum_i V_i N_v(x_i) and the mass sum_i m_i N_v(x_i); ``weight`` (cells, corners) has each cell's part
of the volumes. With a pressure q_v = tau / s at the nodes the force on node u is sum_i V_i q(x_i) grad N_u: so forces add up
to nothing. A small share of each particle goes to all corners of its cell, so that every node with a force has a mass.
"""
import math

import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.for_each_dimension import FAST, D, M, by_dimension
from fe_el.particles.motion import lag
from fe_el.particles.solids_stress import implicit_fraction, stress_over_fraction

BLUR = 0.05  # share of a particle that goes to all corners of its cell alike


@by_dimension
def to_nodes(dofs, barycentric, cell, position, velocity, volume, mass, diameter, weight, sums):
    """Add up volume, mass, mass times velocity and its square, and mass over diameter, in ``sums`` (nodes, d + 4)."""
    for i in range(len(cell)):
        c, square = cell[i], 0.0
        for k in range(D):
            square += velocity[i, k] * velocity[i, k]
        for v in range(M):
            b = barycentric[c, v]
            hat = b[0] * position[i, 0] + b[1] * position[i, 1] + b[2] * position[i, 2] + b[3]
            hat = BLUR / M + (1 - BLUR) * min(max(hat, 0.0), 1.0)
            n, part = dofs[c, v], hat * mass[i]
            weight[c, v] += hat * volume[i]
            sums[n, 0] += hat * volume[i]
            sums[n, 1] += part
            for k in range(D):
                sums[n, 2 + k] += part * velocity[i, k]
            sums[n, 2 + D] += part * square
            sums[n, 3 + D] += part / diameter[i]


@by_dimension
def from_nodes(dofs, barycentric, cell, position, held, damping, mean, change, velocity):
    """v_i += sum_v N_v(x_i) (damping_v (mean_v - v_i) + change_v): what particles gain is what the nodes give."""
    for i in range(len(cell)):
        if held[i]:
            continue
        c, share = cell[i], 0.0
        gain = np.zeros(D)
        for v in range(M):
            b = barycentric[c, v]
            hat = b[0] * position[i, 0] + b[1] * position[i, 1] + b[2] * position[i, 2] + b[3]
            hat = BLUR / M + (1 - BLUR) * min(max(hat, 0.0), 1.0)
            n = dofs[c, v]
            share += hat * damping[n]
            for k in range(D):
                gain[k] += hat * (damping[n] * mean[n, k] + change[n, k])
        for k in range(D):
            velocity[i, k] += gain[k] - share * velocity[i, k]


@by_dimension
def force_of(dofs, gradient, weight, pressure, force):
    """Add the force of the pressure q on the nodes [N]."""
    for c in range(len(dofs)):
        total = 0.0
        for v in range(M):
            total += weight[c, v] * pressure[dofs[c, v]]
        if total == 0.0:
            continue
        for v in range(M):
            for k in range(D):
                force[dofs[c, v], k] += total * gradient[c, v, k]


@by_dimension
def expansion_of(dofs, gradient, weight, velocity, rate):
    """Add the rate at which the particles of each node expand [m^3/s]: the transpose of :func:`force_of`."""
    for c in range(len(dofs)):
        full = 0.0
        for v in range(M):
            full += weight[c, v]
        if full == 0.0:
            continue
        divergence = 0.0
        for v in range(M):
            for k in range(D):
                divergence += gradient[c, v, k] * velocity[dofs[c, v], k]
        for v in range(M):
            rate[dofs[c, v]] += weight[c, v] * divergence


@by_dimension
def column_sums(dofs, gradient, weight, out):
    """Add a bound of the sum of the sizes of the forces on each node per pressure [m^2]."""
    for c in range(len(dofs)):
        full = 0.0
        for v in range(M):
            full += weight[c, v]
        for v in range(M):
            size = 0.0
            for k in range(D):
                size += gradient[c, v, k] * gradient[c, v, k]
            out[dofs[c, v]] += full * math.sqrt(size)


@by_dimension
def row_bounds(dofs, gradient, weight, columns, mass, out):
    """Add the diagonal that bounds (expansion of force / mass), so that steps by its inverse converge (Pock & Chambolle
    2011)."""
    for c in range(len(dofs)):
        total = 0.0
        for v in range(M):
            n, size = dofs[c, v], 0.0
            for k in range(D):
                size += gradient[c, v, k] * gradient[c, v, k]
            total += math.sqrt(size) * columns[n] / mass[n] if mass[n] > 0.0 else 0.0
        for v in range(M):
            out[dofs[c, v]] += weight[c, v] * total


@njit(fastmath=FAST)
def accelerate(free, force, mass, dt, velocity):
    """v = v_free + dt f / m at the nodes that have mass."""
    for n in range(len(mass)):
        for k in range(free.shape[1]):
            velocity[n, k] = free[n, k] + dt * force[n, k] / mass[n] if mass[n] > 0.0 else 0.0


@njit
def force_of_walls(nodes, area_normal, wall, solid, pressure, force, impulse, dt):
    """Add what walls give back of the stress on them, s q per area, and the impulses on the walls."""
    for f in range(len(nodes)):
        for m in range(nodes.shape[1]):
            n = nodes[f, m]
            stress = solid[n] * pressure[n]
            for k in range(area_normal.shape[1]):
                force[n, k] -= stress * area_normal[f, k]
                impulse[wall[f], k] += dt * stress * area_normal[f, k]


@njit
def expansion_at_walls(nodes, area_normal, solid, velocity, rate):
    """Take from the rates what flows into walls: the transpose of :func:`force_of_walls`."""
    for f in range(len(nodes)):
        for m in range(nodes.shape[1]):
            n = nodes[f, m]
            for k in range(area_normal.shape[1]):
                rate[n] -= solid[n] * area_normal[f, k] * velocity[n, k]


@njit
def sizes_at_walls(nodes, area_normal, values, out):
    """Add value times area of each wall facet to its nodes."""
    for f in range(len(nodes)):
        size = 0.0
        for k in range(area_normal.shape[1]):
            size += area_normal[f, k] * area_normal[f, k]
        for m in range(nodes.shape[1]):
            out[nodes[f, m]] += values[nodes[f, m]] * math.sqrt(size)


@njit
def new_pressures(start, rate, room, bound, dt, numbers, carried, fraction, new):
    """One step towards the pressures that belong to the solid fractions at the end of the time step.

    Args:
        start, rate: (nodes,) solid fraction before the step, and the rate at which its particles expand [m^3/s].
        room, bound: (nodes,) volume of the node [m^3], and the bound of :func:`row_bounds`.
        carried: (nodes,) pressures that the rate belongs to [Pa].
        fraction: (nodes,) solid fractions of these, as a first guess; those of the new ones.
        new: (nodes,) filled in.

    Returns:
        Largest difference between a solid fraction by its pressure and by the motion.
    """
    largest = 0.0
    for n in range(len(start)):
        if room[n] <= 0.0:
            new[n] = 0.0
            continue
        step, moved = dt * dt * bound[n] / room[n], start[n] - dt * rate[n] / room[n]
        if step <= 0.0:
            new[n] = 0.0
            continue
        total = moved + step * carried[n]
        fraction[n] = s = implicit_fraction(total, step, fraction[n], numbers)
        new[n] = stress_over_fraction(s, numbers)[0] if s > 0.0 else 0.0
        difference = abs(moved - s) if s > 0.0 else 0.0
        largest = max(largest, difference)
    return largest


@njit(fastmath=FAST)
def damping_of(sums, solid, pressure, restitution, packing, dt, out):
    """Part of their velocity against the mean that inelastic collisions take from the particles of each node in a step.

    The energy of their scatter, variance T in each direction, is lost at the rate 12 (1 - e^2) rho s^2 g T^(3/2) / (sqrt(pi)
    d) with g = 1 / (1 - (s / s_cp)^(1/3)) (Lun et al., J. Fluid Mech. 140, 1984, 223). Where a stress tau holds them
    together they meet at the rate sqrt(tau / (rho s)) / d, the unit of the inertial number (GDR MiDi, Eur. Phys. J. E 14,
    2004, 341).
    """
    d = sums.shape[1] - 4
    for n in range(len(solid)):
        out[n] = 0.0
        if sums[n, 1] > 0.0:
            square = 0.0
            for k in range(d):
                square += (sums[n, 2 + k] / sums[n, 1]) ** 2
            scatter = max(sums[n, 2 + d] / sums[n, 1] - square, 0.0) / d
            near = 1.0 / (1.0 - min(solid[n] / packing, 0.999) ** (1 / 3))
            speed = solid[n] * near * math.sqrt(scatter) + math.sqrt(pressure[n] * sums[n, 0] / sums[n, 1])
            rate = 4 / math.sqrt(math.pi) * (1 - restitution ** 2) * speed * sums[n, 3 + d] / sums[n, 1]
            out[n] = rate * dt / (1 + rate * dt)


@njit(fastmath=FAST)
def crossing_rate(barycentric, cell, velocity, force, inertia, gravity, held, dt):
    """Largest rate at which the hat functions at a particle change [1/s], with its velocity of now or of free flight after
    dt: over 1/rate it goes through a cell. Infinite where one is no number."""
    largest = 0.0
    for i in range(len(cell)):
        if held[i]:
            continue
        for v in range(barycentric.shape[1]):
            now, change = 0.0, 0.0
            for k in range(3):
                now += barycentric[cell[i], v, k] * velocity[i, k]
                change += barycentric[cell[i], v, k] * dt * (gravity[k] + force[i, k] / inertia[i])
            if not abs(now) + abs(change) < np.inf:
                return np.inf
            largest = max(largest, abs(now), abs(now + change))
    return largest


@njit
def force_in_part(force, stress_force, inertia, gravity, rate, held, dt, start, span, out):
    """Force (particles, 3) [N] in the part of a step that begins at ``start``: as :func:`~motion.forces_in_step` has it,
    what velocities are expected to change by fades with their relaxation, minus the stress's force of the last step is
    constant. So the impulse over all parts is that of the step, and without stress free flight in parts is that of the
    whole."""
    for i in range(len(force)):
        part = 1.0
        if rate[i] * dt > 1e-12:
            part = math.exp(-rate[i] * start) * math.expm1(-rate[i] * span) / math.expm1(-rate[i] * dt) * dt / span
        for k in range(3):
            expected = 0.0 if held[i] else inertia[i] * gravity[k] + force[i, k] + stress_force[i, k]
            out[i, k] = part * expected - inertia[i] * gravity[k] - stress_force[i, k]


@njit
def move(position, start, free, velocity, rate, held, dt):
    """Carry positions, which are those of free flight, to where the particles come with the new velocities.

    Where the stress takes the change of velocity back, the particle moves with its new velocity; where there is no stress
    the path of the relaxation stays as it is.
    """
    for i in range(len(position)):
        if held[i]:
            continue
        late, by_stress, by_rest = lag(rate[i] * dt), 0.0, 0.0
        for k in range(3):
            by_stress += (velocity[i, k] - free[i, k]) ** 2
            by_rest += (free[i, k] - start[i, k]) ** 2
        share = min(1.0, math.sqrt(by_stress / by_rest)) if by_rest > 0.0 else 0.0
        for k in range(3):
            position[i, k] += dt * (velocity[i, k] - free[i, k] + (1 - late) * share * (free[i, k] - start[i, k]))
