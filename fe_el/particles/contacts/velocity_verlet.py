"""Velocity Verlet: kicks and drifts of a sub-step."""
from fe_el.compiled.cache import njit
from fe_el.compiled.parts import part
from fe_el.particles.contacts.law_kernels import FAST


@part(fastmath=FAST)
def kick(rows, inverse_inertia, h, owned):
    """v += h F/m, w += h T/I."""
    state, force, inverse_mass = rows.state, rows.force, rows.inverse_mass
    for i in range(owned):
        a, b = h * inverse_mass[i], h * inverse_inertia[i]
        for k in range(3):
            state[i, 1 + k] += a * force[i, k]
            state[i, 4 + k] += b * force[i, 4 + k]


@part(fastmath=FAST)
def kick_and_drift(rows, drift, part, h, begin, end):
    """Kick some particles by ``part`` of a step, drift by a step, reset their forces.

    Returns the largest squares of their displacement from x0, velocity, and change of velocity, each over the room of the
    particle; the last column of x0 (particles, 4) is one over the square of that [1/m^2].
    """
    x, state, force, inverse_mass = rows.x, rows.state, rows.force, rows.inverse_mass
    external, inverse_inertia, x0 = drift.external, drift.inverse_inertia, drift.x0
    largest, fastest, hardest = 0.0, 0.0, 0.0
    for i in range(begin, end):  # reads before it writes: for the compiler one array could be part of another
        a, b, room = part * h * inverse_mass[i], part * h * inverse_inertia[i], x0[i, 3]
        ax, ay, az = a * force[i, 0], a * force[i, 1], a * force[i, 2]
        vx, vy, vz = state[i, 1] + ax, state[i, 2] + ay, state[i, 3] + az
        wx, wy, wz = state[i, 4] + b * force[i, 4], state[i, 5] + b * force[i, 5], state[i, 6] + b * force[i, 6]
        px, py, pz = x[i, 0] + h * vx, x[i, 1] + h * vy, x[i, 2] + h * vz
        qx, qy, qz = px - x0[i, 0], py - x0[i, 1], pz - x0[i, 2]
        fx, fy, fz = external[i, 0], external[i, 1], external[i, 2]
        x[i, 0], x[i, 1], x[i, 2] = px, py, pz
        state[i, 1], state[i, 2], state[i, 3], state[i, 4], state[i, 5], state[i, 6] = vx, vy, vz, wx, wy, wz
        force[i, 0], force[i, 1], force[i, 2], force[i, 3] = fx, fy, fz, 0.0
        force[i, 4] = force[i, 5] = force[i, 6] = force[i, 7] = 0.0
        s = room * (qx * qx + qy * qy + qz * qz)
        fastest = max(room * (vx * vx + vy * vy + vz * vz), fastest)
        hardest = max(room * (ax * ax + ay * ay + az * az), hardest)
        if not s <= largest:
            largest = s
    return largest, fastest, hardest


@part(fastmath=FAST)
def kick_and_drift_fading(rows, drift, part, h, begin, end):
    """The same, with a part of the external force that fades; see :func:`fe_el.particles.motion.forces_in_step`."""
    x, state, force, inverse_mass = rows.x, rows.state, rows.force, rows.inverse_mass
    external, inverse_inertia, x0 = drift.external, drift.inverse_inertia, drift.x0
    fading = drift.fading
    largest, fastest, hardest = 0.0, 0.0, 0.0
    for i in range(begin, end):
        a, b, room, kept = part * h * inverse_mass[i], part * h * inverse_inertia[i], x0[i, 3], fading[i, 3]
        ax, ay, az = a * force[i, 0], a * force[i, 1], a * force[i, 2]
        vx, vy, vz = state[i, 1] + ax, state[i, 2] + ay, state[i, 3] + az
        wx, wy, wz = state[i, 4] + b * force[i, 4], state[i, 5] + b * force[i, 5], state[i, 6] + b * force[i, 6]
        px, py, pz = x[i, 0] + h * vx, x[i, 1] + h * vy, x[i, 2] + h * vz
        qx, qy, qz = px - x0[i, 0], py - x0[i, 1], pz - x0[i, 2]
        gx, gy, gz = kept * fading[i, 0], kept * fading[i, 1], kept * fading[i, 2]
        fx, fy, fz = external[i, 0] + gx, external[i, 1] + gy, external[i, 2] + gz
        x[i, 0], x[i, 1], x[i, 2] = px, py, pz
        state[i, 1], state[i, 2], state[i, 3], state[i, 4], state[i, 5], state[i, 6] = vx, vy, vz, wx, wy, wz
        fading[i, 0], fading[i, 1], fading[i, 2] = gx, gy, gz
        force[i, 0], force[i, 1], force[i, 2], force[i, 3] = fx, fy, fz, 0.0
        force[i, 4] = force[i, 5] = force[i, 6] = force[i, 7] = 0.0
        s = room * (qx * qx + qy * qy + qz * qz)
        fastest = max(room * (vx * vx + vy * vy + vz * vz), fastest)
        hardest = max(room * (ax * ax + ay * ay + az * az), hardest)
        if not s <= largest:
            largest = s
    return largest, fastest, hardest


@njit
def drift_on(rows, drift, part, h, begin, end):
    """A sub-step's kick and drift, with an external force that is constant, or with a part that fades."""
    if len(drift.fading):
        return kick_and_drift_fading(rows, drift, part, h, begin, end)
    return kick_and_drift(rows, drift, part, h, begin, end)
