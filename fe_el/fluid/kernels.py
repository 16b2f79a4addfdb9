"""Numba loops over the cells of the cell-node scheme; cells carry the momentum, nodes the transport."""
import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.for_each_dimension import FAST, D, M, by_dimension

CUT = 4.0  # Courant number times two from which the last step's gain is not trusted, without drag
VISCOUS = (6.0, 80.0)  # viscous fading rate times h^2 / nu on triangles, tetrahedra: measured, see :func:`mass_and_misfit`


@njit(fastmath=FAST)
def fading_rate(speed_squared, h, nu, viscous):
    """Rate at which what a cell's neighbours do not share is carried off: by convection, and ``viscous`` nu / h^2 [1/s]."""
    return 2.0 * np.sqrt(speed_squared) / h + viscous * nu / (h * h)


@njit(fastmath=FAST)
def relaxation_rate(speed_squared, h, nu):
    """Rate at which nodes take over what the cells around them share [1/s]; slow in viscous flow, where the nodes need no
    help."""
    return 4.0 * np.sqrt(speed_squared) / h + nu / (h * h)


@njit(fastmath=FAST)
def relaxation_rate_at_wall(speed_squared, h, nu):
    """The same for nodes on no-slip walls: the cells lie on one side of them, so where the mesh resolves the layer what
    these share is no error of the nodes; where convection is far faster than viscosity the nodes follow as others do."""
    convection = 4.0 * np.sqrt(speed_squared) / h
    return convection * convection / (convection + 16.0 * nu / (h * h) + 1e-300)


@njit(fastmath=FAST)
def left_of(x):
    """What is left after a time x of something that fades at a rate of one: exp(-x) to the third order."""
    return 1.0 / (1.0 + x * (1.0 + x * (0.5 + x / 6.0)))


@njit(fastmath=FAST)
def lag_of(left, x):
    """1 - (1 - left) / x with left = left_of(x): the part of a step that a steady gain misses of its fading."""
    return left * x * (0.5 + x * (1.0 / 3.0 + x / 6.0))


@njit(fastmath=FAST)
def trust(convective, fading, damping):
    """Part of a lag to be taken: less in steps that are long against the fading by convection (``convective``: two Courant
    numbers).

    There the gain of the last step no longer tells that of this one, and energy would grow. With drag (``damping`` = A dt /
    (rho phi + A dt)) steps may be longer. Where nearly all of the ``fading`` is of viscosity it does no harm in steps of any
    length.
    """
    ratio = convective / (CUT + (16.0 - CUT) * damping)
    ratio *= ratio
    viscous = max(fading - convective, 0.0) / max(fading, 1e-300)
    viscous *= viscous * (3.0 - 2.0 * viscous)
    return (1.0 + viscous * viscous * ratio * ratio) / (1.0 + ratio * ratio)


@by_dimension
def mass_and_misfit(cells, step, weight, damping, q, u, known, at_wall, sums):
    """What relaxation needs at the nodes, in ``sums`` (nodes, 2 + 2 d), and what is left of what the nodes do not carry, in
    the :class:`Memory` ``known``.

    The sums are those of the cell masses; of mass times the part of the misfit that is taken over in a step; of mass times
    the misfit q - mean u, as in a least-squares fit (with ``upwind`` of mass times q alone); and of what is taken over of
    the misfit that comes about during the step: what drag and pressure add (gain - mean nodal gain) less what ``fades``, as
    of the last step. ``theta`` gets the part of what the nodes do not carry that is left after the step, ``lag`` the time of
    the step in which what drag and pressure add does not fade, as it acts at the end.

    In steady viscous flow a force that acts in one cell raises its velocity by force / (rho VISCOUS nu / h^2) beside what
    the nodes carry. With 80 the whole is, on tetrahedra, that of Taylor-Hood elements on the same mesh within 2 %, for
    single cells and for ten that lie apart (ten in a heap: 15 to 21 % less, the nodes' part); on triangles larger rates
    make steady pressures worse. In steps longer than the fading drag takes part in transport: see ``DragInTransport``.
    """
    dofs, h, dt, nu, upwind = cells.dofs, cells.size, step.dt, step.nu, step.upwind
    gain, nodal_gain, fades, theta, lag = known.gain, known.nodal_gain, known.fades, known.theta, known.lag
    n = len(dofs)
    share = 1.0 / M
    misfit, feed = np.empty(D), np.empty(D)
    for c in range(n):
        speed = 0.0
        for k in range(D):
            speed += q[c, k] * q[c, k]
        fading, relax = dt * fading_rate(speed, h[c], nu, VISCOUS[D - 2]), dt * relaxation_rate(speed, h[c], nu)
        theta[c], kept = left_of(fading), left_of(relax)
        mass, time = share * weight[c], dt * trust(2.0 * dt * np.sqrt(speed) / h[c], fading, damping[c])
        lag[c] = time * lag_of(theta[c], fading)
        taken, given = mass * (1.0 - kept), time * lag_of(kept, relax)
        wall_relax = dt * relaxation_rate_at_wall(speed, h[c], nu)
        wall_kept = left_of(wall_relax)
        wall_given = time * lag_of(wall_kept, wall_relax)
        for k in range(D):
            mean, rise = 0.0, 0.0
            for i in range(M):
                mean += u[dofs[c, i], k]
                rise += nodal_gain[dofs[c, i], k]
            misfit[k] = mass * (q[c, k] - (0.0 if upwind else share * mean))
            feed[k] = 0.0 if upwind else mass * (gain[c, k] - share * rise - fades[c, k])
        for i in range(M):
            node = dofs[c, i]
            feeding = wall_given if at_wall[node] else given
            sums[node, 0] += mass
            sums[node, 1] += mass * (1.0 - wall_kept) if at_wall[node] else taken
            for k in range(D):
                sums[node, 2 + k] += misfit[k]
                sums[node, 2 + D + k] += feeding * feed[k]


@by_dimension
def mass_flux(dofs, density, phi, q, part, last, now, flux):
    """Mass flux ``now`` of velocity q, and ``flux``, carried on from the last one by a ``part`` of its change."""
    for c in range(len(dofs)):
        for k in range(D):
            now[c, k] = density * phi[c] * q[c, k]
            flux[c, k] = now[c, k]
            if part != 0.0:
                flux[c, k] += part * (now[c, k] - last[c, k])


@by_dimension
def transport_matrix(cells, step, entries, void, stress, flux, open_node, thetas, u, rhs):
    """Add lumped mass, skew-symmetric convection and viscosity to ``entries``; one theta step of the latter two, theta by
    cell.

    ``stress`` is the cell's share of the stress times the viscosity. The void fraction's rate enters as the divergence that
    the flux really has (equal to it up to the solver's tolerance), so that momentum is kept to round-off; nodes of outlets,
    where continuity is not imposed, take the rate itself. What acts on the old velocity u goes to ``rhs``. With ``upwind``,
    what couples two nodes with the wrong sign goes to the diagonal: no node is repelled by another.
    """
    dofs, grad, volume, place, values = cells.dofs, cells.gradient, cells.volume, entries.place, entries.values
    phi1, rate, density, dt, upwind = void.fraction, void.rate, step.density, step.dt, step.upwind
    n = len(dofs)
    share = 1.0 / M
    parts = u.shape[1]
    out, diagonal, old, total = np.empty(M), np.empty(M), np.empty((M, parts)), np.empty((M, parts))
    for c in range(n):
        vol, theta = volume[c], thetas[c]
        inertia, change = share * vol * density * phi1[c] / dt, 0.5 * share * vol * density * rate[c]
        for i in range(M):
            out[i], diagonal[i] = 0.0, inertia
            for k in range(D):
                out[i] += grad[c, i, k] * flux[c, k]
            out[i] *= 0.5 * share * vol
            side = change if open_node[dofs[c, i]] else M * out[i]
            diagonal[i] -= theta * side
            for k in range(parts):
                old[i, k] = u[dofs[c, i], k]
                total[i, k] = -(side + M * out[i]) * old[i, k]  # the sum of the row times u
        for i in range(M):
            for j in range(i):
                g = 0.0
                for k in range(D):
                    g += grad[c, i, k] * grad[c, j, k]
                g *= stress[c] * vol
                skew, excess = out[j] - out[i], 0.0
                if upwind:
                    excess = max(theta * (abs(skew) + g), 0.0)
                values[place[c, i, j]] += theta * (g + skew) - excess
                values[place[c, j, i]] += theta * (g - skew) - excess
                diagonal[i] -= theta * g - excess
                diagonal[j] -= theta * g - excess
                for k in range(parts):
                    rise = old[j, k] - old[i, k]
                    total[i, k] += (g + skew) * rise
                    total[j, k] -= (g - skew) * rise
        for i in range(M):
            values[place[c, i, i]] += diagonal[i]
            for k in range(parts):
                rhs[dofs[c, i], k] -= (1.0 - theta) * total[i, k]


@njit(fastmath=FAST)
def open_boundary(place, values, cell, local, area_normal, flux):
    """Half the outgoing mass flux on open facets, lumped; the flux that comes in brings no energy (backflow-safe)."""
    d = flux.shape[1]
    for f in range(len(cell)):
        c, out = cell[f], 0.0
        for k in range(d):
            out += area_normal[f, k] * flux[c, k]
        out *= 0.5
        if out > 0:
            for i in range(place.shape[1]):
                if i != local[f]:
                    values[place[c, i, i]] += out / d


@by_dimension
def fade(cells, step, masses, q, u, known, kept, mass, defect):
    """What the nodes do not carry, r = q - mean u, fades at a rate k; ``defect`` gets the momentum that lost, per node,
    ``fades`` the change per time, ``mass`` the nodal mass at the end of the step.

    Drag and pressure feed r with a = gain - mean nodal gain, as of the last step. They act after the fading, over a whole
    step; what fades of that meanwhile, lag times a, is taken off beforehand. So r = a / k in a steady state.
    """
    dofs, dt, mass0, mass1 = cells.dofs, step.dt, masses.before, masses.after
    gain, nodal_gain, fades, theta, lag = known.gain, known.nodal_gain, known.fades, known.theta, known.lag
    n = len(dofs)
    share = 1.0 / M
    for c in range(n):
        for i in range(M):
            mass[dofs[c, i]] += share * mass1[c]
        for k in range(D):
            mean, rise = 0.0, 0.0
            for i in range(M):
                mean += u[dofs[c, i], k]
                rise += nodal_gain[dofs[c, i], k]
            r = q[c, k] - share * mean
            kept[c, k] = theta[c] * r - lag[c] * (gain[c, k] - share * rise)
            fades[c, k] = (r - kept[c, k]) / dt
            part = share * (mass1[c] * kept[c, k] - mass0[c] * r)
            for i in range(M):
                defect[dofs[c, i], k] += part


@by_dimension
def exchange_system(cells, step, phi, given, u, correction, kept, q, equation):
    """Cell velocities before the pressure, and the right-hand side of the Poisson equation that follows from eliminating
    them.

    Sets kept to the transported velocity and q to (rho phi/dt u_T + B + part f) / (rho phi/dt + A); ``part`` is the share of
    pressure gradient and body force f that the fluid takes, phi unless the step is one of several; ``weight`` is that of the
    equation. f is ``body``, of each cell or of all.
    """
    dofs, grad, volume, density, dt = cells.dofs, cells.gradient, cells.volume, step.density, step.dt
    part, supply, drag, source, body = given.part, given.supply, given.drag, given.source, given.body
    diagonal, weight, rhs = equation.diagonal, equation.weight, equation.rhs
    n, varies = len(dofs), len(body) > 1
    share = 1.0 / M
    for c in range(n):
        inertia = density * phi[c] / dt
        diagonal[c] = inertia + drag[c]
        weight[c] = phi[c] * part[c] / diagonal[c] * volume[c]
        for k in range(D):
            mean = 0.0
            for i in range(M):
                mean += u[dofs[c, i], k] - correction[dofs[c, i], k]
            kept[c, k] += share * mean
            q[c, k] = (inertia * kept[c, k] + source[c, k] + part[c] * body[c if varies else 0, k]) / diagonal[c]
        for i in range(M):
            flux = 0.0
            for k in range(D):
                flux += grad[c, i, k] * q[c, k]
            rhs[dofs[c, i]] += volume[c] * (phi[c] * flux - share * supply[c])


@by_dimension
def poisson_matrix(dofs, place, grad, weight, values):
    """Add (weight grad p, grad w) to ``values``; ``weight`` holds the cell's volume."""
    for c in range(len(dofs)):
        for i in range(M):
            for j in range(i + 1):
                g = 0.0
                for k in range(D):
                    g += grad[c, i, k] * grad[c, j, k]
                values[place[c, i, j]] += weight[c] * g
                if i != j:
                    values[place[c, j, i]] += weight[c] * g


@by_dimension
def pressure_step(cells, step, phi, part, diagonal, p, transported, q, gain, change):
    """Subtract part grad p / (rho phi/dt + A) from q; ``gain`` is the acceleration, ``change`` the momentum per time and
    node."""
    dofs, grad, volume, density, dt = cells.dofs, cells.gradient, cells.volume, step.density, step.dt
    n = len(dofs)
    share = 1.0 / M
    for c in range(n):
        for k in range(D):
            slope = 0.0
            for i in range(M):
                slope += grad[c, i, k] * p[dofs[c, i]]
            q[c, k] -= part[c] / diagonal[c] * slope
            gain[c, k] = (q[c, k] - transported[c, k]) / dt
            given = share * density * phi[c] * volume[c] * gain[c, k]
            for i in range(M):
                change[dofs[c, i], k] += given


@by_dimension
def mass_balance(dofs, grad, volume, phi, rate, q, residual, scale):
    """Nodal residual of (phi u, grad w) = (dphi/dt, w), and the sum of what passes each node."""
    n = len(dofs)
    for c in range(n):
        for i in range(M):
            flux = 0.0
            for k in range(D):
                flux += grad[c, i, k] * q[c, k]
            residual[dofs[c, i]] += volume[c] * (phi[c] * flux - rate[c] / M)
            scale[dofs[c, i]] += volume[c] * (abs(phi[c] * flux) + abs(rate[c] / M))


@by_dimension
def take_gradient(dofs, grad, psi, flux):
    """Subtract the gradient of a nodal function from ``flux``."""
    for c in range(len(dofs)):
        for k in range(D):
            for i in range(M):
                flux[c, k] -= grad[c, i, k] * psi[dofs[c, i]]
