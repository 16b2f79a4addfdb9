"""Numba loops over the nodes of the cell-node scheme; ghosts that no cell of this rank has are without mass and left out."""
from fe_el.compiled.cache import njit
from fe_el.compiled.direct_calls import Direct
from fe_el.compiled.for_each_dimension import FAST
from fe_el.compiled.parts import part


@njit(fastmath=FAST)
def relaxed(start, sums, upwind, whole, mass, out):
    """Nodal velocity that has taken over its part of the misfit (all of it if ``whole``), and what fed it, from the ``sums``
    of :func:`kernels.mass_and_misfit`; ``mass`` gets the nodal mass."""
    parts = start.shape[1]
    for i in range(len(start)):
        mass[i] = sums[i, 0]
        if mass[i] == 0.0:
            out[i] = start[i]
            continue
        share = 1.0 if whole else sums[i, 1] / mass[i]
        for k in range(parts):
            misfit = sums[i, 2 + k] / mass[i] - (start[i, k] if upwind else 0.0)
            out[i, k] = start[i, k] + share * misfit + sums[i, 2 + parts + k] / mass[i]


@njit(fastmath=FAST)
def _transport_load(mass, u, last_change, load, dt, held, diagonal, out):
    """Fill right-hand side, systems with held values, and guesses, of a :class:`NodalSystem`."""
    force, explicit, lift, rhs, system, guess = load.force, load.explicit, load.lift, out.rhs, out.system, out.guess
    boundary = held.values
    owned = len(diagonal)
    for i in range(len(u)):
        for k in range(u.shape[1]):
            rhs[i, k] = mass[i] * u[i, k] / dt + force[i, k] + explicit[i, k]
            if i < owned:
                system[k, i] = rhs[i, k] + lift[i, k]
                guess[k, i] = u[i, k] + last_change[i, k]
    for i in held.nodes:
        if i < owned:
            for k in range(u.shape[1]):
                system[k, i] = diagonal[i] * boundary[i, k]


transport_load = Direct(_transport_load)


@njit(fastmath=FAST)
def close_transport(mass, rhs, balance, defect, dt, held, new, correction):
    """Nodal velocity from the balance of momentum itself, in ``new`` but for held nodes; ``balance`` becomes the
    reaction."""
    for i in held:
        for k in range(new.shape[1]):
            correction[i, k] = new[i, k]
    for i in range(len(new)):
        for k in range(new.shape[1]):
            total = rhs[i, k] + balance[i, k]
            if mass[i] != 0.0:
                new[i, k] += dt * total / mass[i]
            balance[i, k] = -total
    for i in held:
        for k in range(new.shape[1]):
            new[i, k] = correction[i, k]
    for i in range(len(new)):
        for k in range(new.shape[1]):
            correction[i, k] = defect[i, k] / mass[i] if mass[i] != 0.0 else 0.0


@njit(fastmath=FAST)
def carry_on(force, last, ratio, held, slip, normal, out):
    """The last step's force, and where walls take their share what its change leads to, at most twice itself.

    At the nodes ``slip``, with normals, this is the normal part; at nodes ``held`` all of it.
    """
    out[:] = force
    for n in range(len(slip)):
        i, along = slip[n], 0.0
        for k in range(force.shape[1]):
            rise, most = ratio * (force[i, k] - last[i, k]), abs(force[i, k])
            along += normal[n, k] * min(max(rise, -most), most)
        for k in range(force.shape[1]):
            out[i, k] += normal[n, k] * along
    for i in held:
        for k in range(force.shape[1]):
            out[i, k] = force[i, k]
    for i in held:
        for k in range(force.shape[1]):
            rise, most = ratio * (force[i, k] - last[i, k]), abs(force[i, k])
            out[i, k] += min(max(rise, -most), most)


@njit(fastmath=FAST)
def take_force(u, force, mass, dt, out):
    """u - dt force / mass."""
    for i in range(len(u)):
        for k in range(u.shape[1]):
            out[i, k] = u[i, k] - (dt * force[i, k] / mass[i] if mass[i] != 0.0 else 0.0)


@njit(fastmath=FAST)
def after_exchange(u, force, correction, mass, dt, new, gain):
    """Nodal velocity after the force; ``gain`` is what raises the nodes against their cells per time: the force, and the
    momentum that fading took off the cells."""
    for i in range(len(u)):
        for k in range(u.shape[1]):
            rise = force[i, k] / mass[i] if mass[i] != 0.0 else 0.0
            new[i, k] = u[i, k] + dt * rise
            gain[i, k] = rise + correction[i, k] / dt


@njit(fastmath=FAST)
def extrapolate(past, last, order, guess):
    """Polynomial of the given order through the ``last`` values and those ``past`` (nodes, 3; latest first), one step
    further."""
    for i in range(len(guess)):
        a, b, c = past[i, 0], past[i, 1], past[i, 2]
        if order == 0:
            guess[i] = last[i]
        elif order == 1:
            guess[i] = 2.0 * last[i] - a
        elif order == 2:
            guess[i] = 3.0 * (last[i] - a) + b
        else:
            guess[i] = 4.0 * (last[i] + b) - 6.0 * a - c


@njit(fastmath=FAST)
def misses(past, last, new, out):
    """Squares of what the extrapolations of order 0 to 3 would have missed of ``new``, summed; ``last`` then joins the
    ``past``."""
    out[:] = 0.0
    for i in range(len(last)):
        a, b, c = past[i, 0], past[i, 1], past[i, 2]
        if i < len(new):
            out[0] += (new[i] - last[i]) ** 2
            out[1] += (new[i] - 2.0 * last[i] + a) ** 2
            out[2] += (new[i] - 3.0 * (last[i] - a) - b) ** 2
            out[3] += (new[i] - 4.0 * (last[i] + b) + 6.0 * a + c) ** 2
        past[i, 0], past[i, 1], past[i, 2] = last[i], a, b


@part(fastmath=FAST)
def take_normal(u, i, normal):
    """Take the normal part of one node, in place; returns that part."""
    along = 0.0
    for k in range(u.shape[1]):
        along += normal[k] * u[i, k]
    for k in range(u.shape[1]):
        u[i, k] -= normal[k] * along
    return along


@njit(fastmath=FAST)
def slip(u, nodes, normal, fixed, mass, rate, force):
    """Take the normal part at slip walls, in place, and add what that took, mass times velocity times ``rate``, to
    ``force``."""
    for n in range(len(nodes)):
        i = nodes[n]
        if not fixed[i]:
            along = take_normal(u, i, normal[n])
            for k in range(u.shape[1]):
                force[i, k] -= rate * mass[i] * normal[n, k] * along


@njit(fastmath=FAST)
def impose(u, slip, normal, held, boundary):
    """Take the normal part at slip walls, one after the other, and set the held nodes, in place."""
    for n in range(len(slip)):
        take_normal(u, slip[n], normal[n])
    for i in held:
        for k in range(u.shape[1]):
            u[i, k] = boundary[i, k]


@njit
def pass_boundaries(nodes, owned, places, through, old, outside, part, values, rhs):
    """What leaves through boundary nodes takes their value along, ``part`` of it implicit; what enters has the value
    ``outside``, which becomes that of what leaves. Entries of the matrix of owned nodes lie at ``places``."""
    for i in nodes:
        if through[i] > 0.0:
            outside[i] = old[i, 0]
            rhs[i, 0] -= (1.0 - part) * through[i] * old[i, 0]
            if i < owned:
                values[places[i]] += part * through[i]
        else:
            rhs[i, 0] -= through[i] * outside[i]
