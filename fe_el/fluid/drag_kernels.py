"""Numba loops of transport with drag: see :mod:`fe_el.fluid.drag_in_transport`."""
from fe_el.compiled.cache import njit
from fe_el.compiled.for_each_dimension import FAST, D, M, by_dimension
from fe_el.fluid.relaxation import fading_rate, lag_of


@by_dimension
def drag_in_transport(cells, step, masses, entries, acting, seen, q, u, known, load):
    """Add to the matrix of transport and to its load what drag A, source B and the fading by viscosity give to the nodes.

    The gain becomes p + b for a nodal velocity of zero; a ``part`` of the mean of that velocity comes off it.
    """
    dofs, grad, volume, dt, mass0, mass1 = cells.dofs, cells.gradient, cells.volume, step.dt, masses.before, masses.after
    taken, drag, source, body = acting.part, acting.drag, acting.source, acting.body
    split, stays, part, mobility, reach = seen.split, seen.stay, seen.part, seen.mobility, seen.reach
    pressure = seen.pressure
    gain, nodal_gain, left, lag = known.gain, known.nodal_gain, known.left, known.lag
    place, values = entries.place, entries.values
    n, varies = len(dofs), len(body) > 1
    share = 1.0 / M
    for c in range(n):
        inertia, stay = mass1[c] / volume[c], dt - lag[c]
        rest = 1.0 / (inertia + drag[c] * stay)
        stays[c], part[c], mobility[c] = stay, drag[c] * rest, taken[c] * rest
        reach[c] = mass1[c] * (1.0 - split[c] / dt * stay)
        for k in range(D):
            mean, rise, slope = 0.0, 0.0, 0.0
            for i in range(M):
                mean += u[dofs[c, i], k]
                rise += nodal_gain[dofs[c, i], k]
                slope += grad[c, i, k] * pressure[dofs[c, i]]
            r = q[c, k] - share * mean
            p = taken[c] * (body[c if varies else 0, k] - slope) / inertia
            g = p + rest * (source[c, k] - drag[c] * (left[c] * r + stay * (p - share * rise)))
            kept = left[c] * r + stay * (g - share * rise)
            gain[c, k] = g
            force = share * (mass1[c] * g - split[c] / dt * (mass1[c] * kept - mass0[c] * r))
            for i in range(M):
                load[dofs[c, i], k] += force
        weight = share * share * reach[c] * part[c]
        for i in range(M):
            for j in range(M):
                values[place[c, i, j]] += weight


@by_dimension
def gain_with_nodes(cells, mass1, part, new, gain, force):
    """The gain that goes with the ``new`` nodal velocity, and in ``force`` nodal sums of it: what transport was given."""
    dofs = cells.dofs
    n = len(dofs)
    share = 1.0 / M
    for c in range(n):
        for k in range(D):
            now = 0.0
            for i in range(M):
                now += new[dofs[c, i], k]
            gain[c, k] -= part[c] * share * now
            for i in range(M):
                force[dofs[c, i], k] += share * mass1[c] * gain[c, k]


@by_dimension
def before_exchange(dofs, dt, q, u, force, mass, gain, kept, fades):
    """Take off what cells keep the gain that exchange will give them, less what their nodes have of it."""
    n = len(dofs)
    share = 1.0 / M
    for c in range(n):
        for k in range(D):
            mean, rise = 0.0, 0.0
            for i in range(M):
                mean += u[dofs[c, i], k]
                rise += force[dofs[c, i], k] / mass[dofs[c, i]]
            kept[c, k] -= dt * (gain[c, k] - share * rise)
            fades[c, k] = (q[c, k] - share * mean - kept[c, k]) / dt


@njit(fastmath=FAST)
def share_of_viscosity(q, h, viscous, dt, left, lag, split):
    """Share of viscosity, ``viscous`` / h^2, in the rate at which what the nodes do not carry fades; and the lag for a gain
    of this step.

    Of a lag that is nearly dt, a part per cent less would leave the cell many times what viscosity lets it have: the part
    of the trust in it is that of its logarithm, of dt - lag. It is convection's: viscosity's share is trusted fully.
    """
    for c in range(len(h)):
        speed = 0.0
        for k in range(q.shape[1]):
            speed += q[c, k] * q[c, k]
        fading = fading_rate(speed, h[c], viscous, 1.0)
        split[c] = viscous / (h[c] * h[c] * fading)
        whole = lag_of(left[c], dt * fading)
        if whole > 0.0:
            trust = split[c] + (1.0 - split[c]) * lag[c] / (dt * whole)
            lag[c] = dt * (1.0 - max(1.0 - whole, 0.0) ** trust)


@njit
def any_of(drag, source):
    """Whether there is drag or a source anywhere."""
    for c in range(len(drag)):
        if drag[c] != 0.0:
            return True
        for k in range(source.shape[1]):
            if source[c, k] != 0.0:
                return True
    return False
