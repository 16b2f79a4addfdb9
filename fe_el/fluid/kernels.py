"""Numba loops over the cells of the cell-node scheme; cells carry the momentum, nodes the transport."""
import numpy as np
from numba import njit

from fe_el.fluid.for_each_dimension import FAST, D, M, by_dimension

CUT = 4.0  # Courant number times two from which the last step's gain is not trusted, without drag


@njit(cache=True, fastmath=FAST)
def fading_rate(speed_squared, h, nu):
    """Rate at which what a cell's neighbours do not share is carried off by convection and viscosity [1/s]."""
    return 2.0 * np.sqrt(speed_squared) / h + 4.0 * nu / (h * h)


@njit(cache=True, fastmath=FAST)
def relaxation_rate(speed_squared, h, nu):
    """Rate at which nodes take over what the cells around them share [1/s]; slow in viscous flow, where the nodes need no help."""
    return 4.0 * np.sqrt(speed_squared) / h + nu / (h * h)


@njit(cache=True, fastmath=FAST)
def lag_of(lost, rate, dt, fading, h, nu, damping):
    """dt - lost / rate with lost = 1 - exp(-rate dt): the time of a step that a steady gain misses of its fading at ``rate``.

    Less in steps that are long against the fading, most of all by viscosity: there the gain of the last step no longer tells
    that of this one, and energy would grow. With drag (``damping`` = A dt / (rho phi + A dt)) steps may be longer.
    """
    x = rate * dt
    lag = dt - lost / rate if x > 1e-6 else 0.5 * x * dt
    return lag / (1.0 + (nu * dt / (h * h)) ** 4 + (fading * dt / (CUT + (16.0 - CUT) * damping)) ** 4)


@by_dimension
def mass_and_misfit(dofs, weight, q, u, h, nu, dt, damping, gain, nodal_gain, fades, mass, misfit, part, feed, theta):
    """Nodal sums of the cell masses, of mass times (q - mean u) as in a least-squares fit, and of mass times the part of the
    misfit that is taken over in a step; ``feed`` gets what is taken over of the misfit that comes about during the step: what
    drag and pressure add (gain - mean nodal gain) less what ``fades``, as of the last step. ``theta`` gets the part of what the
    nodes do not carry that is left after the step."""
    n = len(dofs)
    share = 1.0 / M
    for c in range(n):
        speed = 0.0
        for k in range(D):
            speed += q[c, k] * q[c, k]
        fading = fading_rate(speed, h[c], nu)
        theta[c] = np.exp(-dt * fading)
        relax = relaxation_rate(speed, h[c], nu)
        taken = -np.expm1(-dt * relax)
        lag = lag_of(taken, relax, dt, fading, h[c], nu, damping[c])
        for i in range(M):
            mass[dofs[c, i]] += share * weight[c]
            part[dofs[c, i]] += share * weight[c] * taken
        for k in range(D):
            mean, rise = 0.0, 0.0
            for i in range(M):
                mean += u[dofs[c, i], k]
                rise += nodal_gain[dofs[c, i], k]
            misfit_k = share * weight[c] * (q[c, k] - share * mean)
            feed_k = share * weight[c] * lag * (gain[c, k] - share * rise - fades[c, k])
            for i in range(M):
                misfit[dofs[c, i], k] += misfit_k
                feed[dofs[c, i], k] += feed_k


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
def scatter(dofs, total, out):
    """Add cell totals in equal shares to the nodes."""
    share = 1.0 / M
    for c in range(len(dofs)):
        for i in range(M):
            for k in range(total.shape[1]):
                out[dofs[c, i], k] += share * total[c, k]


@by_dimension
def transport_matrix(dofs, grad, volume, density, stress, dt, phi1, rate, flux, open_node, thetas, u, values, rhs):
    """Element matrices of lumped mass, skew-symmetric convection and viscosity; one theta step of both, theta by cell.

    ``stress`` is the cell's share of the stress times the viscosity. The void fraction's rate enters as the divergence that the
    flux really has (equal to it up to the solver's tolerance), so that momentum is kept to round-off; nodes of outlets, where
    continuity is not imposed, take the rate itself. What acts on the old velocity u goes to ``rhs``.
    """
    n = len(dofs)
    share = 1.0 / M
    parts = u.shape[1]
    out, row, old = np.empty(M), np.empty(M), np.empty((M, parts))
    for c in range(n):
        vol, theta = volume[c], thetas[c]
        for i in range(M):
            out[i] = 0.0
            for k in range(D):
                out[i] += grad[c, i, k] * flux[c, k]
            for k in range(parts):
                old[i, k] = u[dofs[c, i], k]
            out[i] *= 0.5 * share * vol
        inertia, change = share * vol * density * phi1[c] / dt, 0.5 * share * vol * density * rate[c]
        for i in range(M):
            for j in range(M):
                g = 0.0
                for k in range(D):
                    g += grad[c, i, k] * grad[c, j, k]
                value = out[j] - out[i] + stress[c] * vol * g
                if i == j:
                    value -= change if open_node[dofs[c, i]] else M * out[i]
                row[j] = value
                values[c, i, j] = theta * value
            for k in range(parts):
                total = 0.0
                for j in range(M):
                    total += row[j] * old[j, k]
                rhs[dofs[c, i], k] -= (1.0 - theta) * total
            values[c, i, i] += inertia


@njit(cache=True, fastmath=FAST)
def open_boundary(cell, local, area_normal, flux, values):
    """Half the outgoing mass flux on open facets, lumped; the flux that comes in brings no energy (backflow-safe)."""
    d = flux.shape[1]
    for f in range(len(cell)):
        c, out = cell[f], 0.0
        for k in range(d):
            out += area_normal[f, k] * flux[c, k]
        out *= 0.5
        if out > 0:
            for i in range(values.shape[1]):
                if i != local[f]:
                    values[c, i, i] += out / d


@by_dimension
def apply_elements(dofs, values, u, out):
    """Subtract the element matrices times u from ``out``."""
    n = len(dofs)
    for c in range(n):
        for i in range(M):
            for k in range(u.shape[1]):
                total = 0.0
                for j in range(M):
                    total += values[c, i, j] * u[dofs[c, j], k]
                out[dofs[c, i], k] -= total


@by_dimension
def fix_rows(dofs, at, fixed, values, kept, lift, boundary):
    """Replace rows and columns of fixed nodes by a diagonal in the element matrices of the cells ``at``, which go to ``kept``
    as they were; what columns carried goes to ``lift``."""
    for n in range(len(at)):
        c = at[n]
        for i in range(M):
            for j in range(M):
                kept[n, i, j] = values[c, i, j]
        for i in range(M):
            if fixed[dofs[c, i]]:
                for j in range(M):
                    if j != i:
                        if not fixed[dofs[c, j]]:
                            for k in range(boundary.shape[1]):
                                lift[dofs[c, j], k] -= values[c, j, i] * boundary[dofs[c, i], k]
                        values[c, i, j] = 0.0
                        values[c, j, i] = 0.0
                values[c, i, i] = abs(values[c, i, i]) + 1e-300


@by_dimension
def memory(dofs, mass0, mass1, q, u, h, dt, nu, theta, damping, gain, nodal_gain, fades, kept, defect):
    """What the nodes do not carry, r = q - mean u, fades at a rate k; ``defect`` gets the momentum that lost, per node, ``fades``
    the change per time.

    Drag and pressure feed r with a = gain - mean nodal gain, as of the last step. They act after the fading, over a whole step;
    what fades of that meanwhile, (dt - (1 - exp(-k dt)) / k) a, is taken off beforehand. So r = a / k in a steady state.
    """
    n = len(dofs)
    share = 1.0 / M
    for c in range(n):
        speed = 0.0
        for k in range(D):
            speed += q[c, k] * q[c, k]
        rate = fading_rate(speed, h[c], nu)
        lag = lag_of(1.0 - theta[c], rate, dt, rate, h[c], nu, damping[c])
        for k in range(D):
            mean, rise = 0.0, 0.0
            for i in range(M):
                mean += u[dofs[c, i], k]
                rise += nodal_gain[dofs[c, i], k]
            r = q[c, k] - share * mean
            kept[c, k] = theta[c] * r - lag * (gain[c, k] - share * rise)
            fades[c, k] = (r - kept[c, k]) / dt
            part = share * (mass1[c] * kept[c, k] - mass0[c] * r)
            for i in range(M):
                defect[dofs[c, i], k] += part


@by_dimension
def exchange_system(dofs, grad, volume, density, dt, phi, part, supply, drag, source, body, u, correction, kept, q, diagonal,
                    weight, rhs):
    """Cell velocities before the pressure, and the right-hand side of the Poisson equation that follows from eliminating them.

    Sets kept to the transported velocity and q to (rho phi/dt u_T + B + part f) / (rho phi/dt + A); ``part`` is the share of
    pressure gradient and body force f that the fluid takes, phi unless the step is one of several; ``weight`` is that of the
    equation.
    """
    n = len(dofs)
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
            q[c, k] = (inertia * kept[c, k] + source[c, k] + part[c] * body[c, k]) / diagonal[c]
        for i in range(M):
            flux = 0.0
            for k in range(D):
                flux += grad[c, i, k] * q[c, k]
            rhs[dofs[c, i]] += volume[c] * (phi[c] * flux - share * supply[c])


@by_dimension
def poisson_matrix(dofs, grad, weight, values):
    """Element matrices of (weight grad p, grad w); ``weight`` holds the cell's volume."""
    for c in range(len(dofs)):
        for i in range(M):
            for j in range(M):
                g = 0.0
                for k in range(D):
                    g += grad[c, i, k] * grad[c, j, k]
                values[c, i, j] = weight[c] * g


@by_dimension
def pressure_step(dofs, grad, volume, density, dt, phi, part, diagonal, p, transported, q, gain, change):
    """Subtract part grad p / (rho phi/dt + A) from q; ``gain`` is the acceleration, ``change`` the momentum per time and node."""
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
