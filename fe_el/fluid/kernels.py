"""Numba loops over the cells of the cell-node scheme; cells carry the momentum, nodes the transport."""
import numpy as np
from numba import njit

FAST = {"contract", "reassoc", "nsz", "arcp"}


@njit(cache=True, fastmath=FAST)
def mass_and_misfit(dofs, weight, q, u, mass, misfit):
    """Nodal sums of the cell masses and of mass times (q - mean u): the right-hand side of the least-squares fit."""
    n, m = dofs.shape
    d = q.shape[1]
    share = 1.0 / m
    for c in range(n):
        for i in range(m):
            mass[dofs[c, i]] += share * weight[c]
        for k in range(d):
            mean = 0.0
            for i in range(m):
                mean += u[dofs[c, i], k]
            part = share * weight[c] * (q[c, k] - share * mean)
            for i in range(m):
                misfit[dofs[c, i], k] += part


@njit(cache=True, fastmath=FAST)
def scatter(dofs, total, out):
    """Add cell totals in equal shares to the nodes."""
    share = 1.0 / dofs.shape[1]
    for c in range(len(dofs)):
        for i in range(dofs.shape[1]):
            for k in range(total.shape[1]):
                out[dofs[c, i], k] += share * total[c, k]


@njit(cache=True, fastmath=FAST)
def transport_matrix(dofs, grad, volume, density, viscosity, dt, phi0, phi1, rate0, share_of_stress, q, open_node, values):
    """Element matrices of lumped mass, skew-symmetric convection by M = rho phi0 q, and viscosity.

    The void fraction's rate enters as the divergence that M really has (equal to it up to the solver's tolerance), so that
    momentum is kept to round-off; nodes of outlets, where continuity is not imposed, take the rate itself.
    """
    n, m = dofs.shape
    d = q.shape[1]
    share = 1.0 / m
    flux = np.empty(m)
    for c in range(n):
        vol = volume[c]
        for i in range(m):
            flux[i] = 0.0
            for k in range(d):
                flux[i] += grad[c, i, k] * q[c, k]
            flux[i] *= 0.5 * share * density * phi0[c] * vol
        inertia, change = share * vol * density * phi1[c] / dt, 0.5 * share * vol * density * rate0[c]
        for i in range(m):
            for j in range(m):
                g = 0.0
                for k in range(d):
                    g += grad[c, i, k] * grad[c, j, k]
                values[c, i, j] = flux[j] - flux[i] + share_of_stress[c] * viscosity * vol * g
            values[c, i, i] += inertia - (change if open_node[dofs[c, i]] else m * flux[i])


@njit(cache=True, fastmath=FAST)
def open_boundary(cell, local, area_normal, density, phi0, q, values):
    """Half the outgoing mass flux on open facets, lumped; the flux that comes in brings no energy (backflow-safe)."""
    d = q.shape[1]
    for f in range(len(cell)):
        c, out = cell[f], 0.0
        for k in range(d):
            out += area_normal[f, k] * q[c, k]
        out *= 0.5 * density * phi0[c]
        if out > 0:
            for i in range(values.shape[1]):
                if i != local[f]:
                    values[c, i, i] += out / d


@njit(cache=True, fastmath=FAST)
def apply_elements(dofs, values, u, out):
    """Subtract the element matrices times u from ``out``."""
    n, m = dofs.shape
    for c in range(n):
        for i in range(m):
            for k in range(u.shape[1]):
                total = 0.0
                for j in range(m):
                    total += values[c, i, j] * u[dofs[c, j], k]
                out[dofs[c, i], k] -= total


@njit(cache=True)
def fix_rows(dofs, fixed, values, lift, boundary):
    """Replace the rows and columns of fixed nodes by a diagonal; what the columns carried goes to ``lift``."""
    n, m = dofs.shape
    for c in range(n):
        for i in range(m):
            if fixed[dofs[c, i]]:
                for j in range(m):
                    if j != i:
                        if not fixed[dofs[c, j]]:
                            for k in range(boundary.shape[1]):
                                lift[dofs[c, j], k] -= values[c, j, i] * boundary[dofs[c, i], k]
                        values[c, i, j] = 0.0
                        values[c, j, i] = 0.0
                values[c, i, i] = abs(values[c, i, i]) + 1e-300


@njit(cache=True, fastmath=FAST)
def memory(dofs, mass0, mass1, q, u, h, dt, nu, kept, defect):
    """What the nodes do not carry, q - mean u, fades by theta; ``defect`` gets the momentum that lost, per node."""
    n, m = dofs.shape
    d = q.shape[1]
    share = 1.0 / m
    for c in range(n):
        speed = 0.0
        for k in range(d):
            speed += q[c, k] * q[c, k]
        theta = 1.0 / (1.0 + dt * (2.0 * np.sqrt(speed) / h[c] + 4.0 * nu / (h[c] * h[c])))
        for k in range(d):
            mean = 0.0
            for i in range(m):
                mean += u[dofs[c, i], k]
            r = q[c, k] - share * mean
            kept[c, k] = theta * r
            part = share * (mass1[c] * theta - mass0[c]) * r
            for i in range(m):
                defect[dofs[c, i], k] += part


@njit(cache=True, fastmath=FAST)
def exchange_system(dofs, grad, volume, density, dt, phi, rate, drag, source, body, u, correction, kept, q, diagonal,
                    values, rhs):
    """Cell velocities before the pressure, and the Poisson system that follows from eliminating them.

    Sets kept to the transported velocity and q to (rho phi/dt u_T + B + phi f) / (rho phi/dt + A).
    """
    n, m = dofs.shape
    d = q.shape[1]
    share = 1.0 / m
    for c in range(n):
        inertia = density * phi[c] / dt
        diagonal[c] = inertia + drag[c]
        for k in range(d):
            mean = 0.0
            for i in range(m):
                mean += u[dofs[c, i], k] - correction[dofs[c, i], k]
            kept[c, k] += share * mean
            q[c, k] = (inertia * kept[c, k] + source[c, k] + phi[c] * density * body[k]) / diagonal[c]
        weight = phi[c] * phi[c] / diagonal[c] * volume[c]
        for i in range(m):
            flux = 0.0
            for k in range(d):
                flux += grad[c, i, k] * q[c, k]
            rhs[dofs[c, i]] += volume[c] * (phi[c] * flux - share * rate[c])
            for j in range(m):
                g = 0.0
                for k in range(d):
                    g += grad[c, i, k] * grad[c, j, k]
                values[c, i, j] = weight * g


@njit(cache=True, fastmath=FAST)
def pressure_step(dofs, grad, volume, density, dt, phi, diagonal, p, transported, q, change):
    """Subtract phi grad p / (rho phi/dt + A) from q; ``change`` gets the momentum gained per time, per node."""
    n, m = dofs.shape
    d = q.shape[1]
    share = 1.0 / m
    for c in range(n):
        for k in range(d):
            slope = 0.0
            for i in range(m):
                slope += grad[c, i, k] * p[dofs[c, i]]
            q[c, k] -= phi[c] / diagonal[c] * slope
            part = share * density * phi[c] * volume[c] / dt * (q[c, k] - transported[c, k])
            for i in range(m):
                change[dofs[c, i], k] += part


@njit(cache=True, fastmath=FAST)
def mass_balance(dofs, grad, volume, phi, rate, q, residual, scale):
    """Nodal residual of (phi u, grad w) = (dphi/dt, w), and the sum of what passes each node."""
    n, m = dofs.shape
    for c in range(n):
        for i in range(m):
            flux = 0.0
            for k in range(q.shape[1]):
                flux += grad[c, i, k] * q[c, k]
            residual[dofs[c, i]] += volume[c] * (phi[c] * flux - rate[c] / m)
            scale[dofs[c, i]] += volume[c] * (abs(phi[c] * flux) + abs(rate[c] / m))
