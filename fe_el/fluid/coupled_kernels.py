"""Numba loops of the pressure within transport: see :mod:`fe_el.fluid.coupled_pressure`."""
from fe_el.compiled.cache import njit
from fe_el.compiled.for_each_dimension import FAST, D, M, by_dimension


@by_dimension
def start_of_cells(cells, answer, known, stay, q, u, kept, flux):
    """What cells keep beside nodes and gain, and the flux of the solids for a velocity of zero."""
    dofs, nodal_gain, left, to_velocity = cells.dofs, known.nodal_gain, known.left, answer.to_velocity
    share = 1.0 / M
    for c in range(len(dofs)):
        for k in range(D):
            mean, rise = 0.0, 0.0
            for i in range(M):
                mean += u[dofs[c, i], k]
                rise += nodal_gain[dofs[c, i], k]
            kept[c, k] = left[c] * (q[c, k] - share * mean) - stay[c] * share * rise
            flux[c, k] = -to_velocity[c] * q[c, k]


@by_dimension
def push(cells, answer, seen, z, gain, flux, load):
    """What a pressure z gives to the cells for a nodal velocity of zero, to the flux of the solids, and to the nodes."""
    dofs, grad, mobility, reach, to_gradient = cells.dofs, cells.gradient, seen.mobility, seen.reach, answer.to_gradient
    share = 1.0 / M
    for c in range(len(dofs)):
        for k in range(D):
            slope = 0.0
            for i in range(M):
                slope += grad[c, i, k] * z[dofs[c, i]]
            gain[c, k] = -mobility[c] * slope
            flux[c, k] = -to_gradient[c] * slope
            force = share * reach[c] * gain[c, k]
            for i in range(M):
                load[dofs[c, i], k] += force


@by_dimension
def add_divergence(cells, phi, answer, seen, u, gain, v, flux, out):
    """Add E u and what the gain leaves to ``v``, and (phi v + a v + flux, grad w) to ``out``."""
    dofs, grad, volume, part, stay = cells.dofs, cells.gradient, cells.volume, seen.part, seen.stay
    to_velocity = answer.to_velocity
    share = 1.0 / M
    for c in range(len(dofs)):
        own, through = share * (1.0 - stay[c] * part[c]), phi[c] + to_velocity[c]
        for k in range(D):
            mean = 0.0
            for i in range(M):
                mean += u[dofs[c, i], k]
            v[c, k] += own * mean + stay[c] * gain[c, k]
            passing = volume[c] * (through * v[c, k] + flux[c, k])
            for i in range(M):
                out[dofs[c, i]] += passing * grad[c, i, k]


@by_dimension
def resist(dofs, seen, drag):
    """Add drag as transport has it to the nodes [kg/s]."""
    part, reach = seen.part, seen.reach
    share = 1.0 / M
    for c in range(len(dofs)):
        for i in range(M):
            drag[dofs[c, i]] += share * reach[c] * part[c]


@by_dimension
def mobilities(cells, mass1, phi, answer, seen, times, weight):
    """The flux (times volume) that minus a pressure gradient makes in each cell without viscosity between nodes, whose
    inertia and drag let them follow a gain for ``times`` [s]."""
    dofs, volume, stay, part, mobility, reach = cells.dofs, cells.volume, seen.stay, seen.part, seen.mobility, seen.reach
    to_velocity, to_gradient = answer.to_velocity, answer.to_gradient
    share = 1.0 / M
    for c in range(len(dofs)):
        mean = 0.0
        for i in range(M):
            mean += times[dofs[c, i]]
        whole = stay[c] + share * mean * (1.0 - stay[c] * part[c]) * reach[c] / mass1[c]
        weight[c] = volume[c] * ((phi[c] + to_velocity[c]) * mobility[c] * whole + to_gradient[c])


@by_dimension
def power_of(cells, given, stress, u, v, tolerance):
    """Power of drag and sources, of viscosity, and the part ``tolerance`` of that of forces that cancel [W]."""
    dofs, grad, volume, h = cells.dofs, cells.gradient, cells.volume, cells.size
    part, drag, source, body = given.part, given.drag, given.source, given.body
    varies, power = len(body) > 1, 0.0
    for c in range(len(dofs)):
        rigid = drag[c] + stress[c] / (h[c] * h[c])
        for k in range(D):
            whole = abs(source[c, k]) + rigid * abs(v[c, k]) + abs(part[c] * body[c if varies else 0, k])
            here = abs((source[c, k] - drag[c] * v[c, k]) * v[c, k]) + tolerance * whole * abs(v[c, k])
            for j in range(D):
                slope = 0.0
                for i in range(M):
                    slope += grad[c, i, j] * u[dofs[c, i], k]
                here += stress[c] * slope * slope
            power += volume[c] * here
    return power


@by_dimension
def take_supply(dofs, volume, supply, out):
    """Subtract the volume that cells give off from the nodal sums."""
    for c in range(len(dofs)):
        for i in range(M):
            out[dofs[c, i]] -= volume[c] * supply[c] / M


@njit(fastmath=FAST)
def power_of_lack(lack, factor, mass, viscous):
    """Power against viscosity of what the nodes lack [W]; ``viscous`` gets the pressure [Pa] that goes with one of them."""
    power = 0.0
    for i in range(len(lack)):
        viscous[i] = factor / mass[i] if mass[i] > 0.0 else 0.0
        power += viscous[i] * lack[i] * lack[i]
    return power
