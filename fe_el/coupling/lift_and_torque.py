"""Lift on particles and the torque that spins them: forces of the open list (:mod:`fe_el.coupling.fluid_at_particles`).

Laws are those of one sphere in a fluid that is wide around it; parcels feel what their particles do. With Omega = 1/2 curl u
- omega the spin of the fluid relative to that of the particle, and s = u - v the slip: Re = rho |s| d / mu, Re_R = rho
|Omega| d^2 / mu.
"""
from typing import TYPE_CHECKING

import numpy as np

from fe_el.coupling.fluid_at_particles import inner_nodes
from fe_el.coupling.smoothing import Nodes

if TYPE_CHECKING:
    from fe_el.coupling.fluid_at_particles import FluidAtParticles

TINY = 1e-300


def _size(vectors):
    return np.sqrt((vectors * vectors).sum(1))


def _cross(spin, slip):
    """Cross product (n, d) of (n, 3) and (n, d)."""
    out = np.cross(spin, np.hstack([slip, np.zeros((len(slip), 3 - slip.shape[1]))]))
    return out[:, :slip.shape[1]]


class SaffmanLift:
    """Lift of a particle that lags in a sheared flow, 1.615 d^2 sqrt(mu rho / |curl u|) f s x curl u.

    Saffman, J. Fluid Mech. 22 (1965) 385; f is Mei's (Int. J. Multiphase Flow 18 (1992) 145) for finite Reynolds numbers:
    with b = d |curl u| / (2 |s|), (1 - 0.3314 sqrt b) exp(-Re/10) + 0.3314 sqrt b up to Re = 40, 0.0524 sqrt(b Re) beyond;
    fitted for b of 0.005 to 0.4, Re up to 100.
    """

    needs = ("slip", "vorticity")

    def force(self, fluid: "FluidAtParticles") -> np.ndarray:
        """(particles, d) [N]."""
        p, d = fluid.particles, fluid.particles.primary_diameter
        turn, slip = _size(fluid.vorticity), _size(fluid.slip)
        re, root = fluid.density * slip * d / fluid.viscosity, np.sqrt(0.5 * d * turn / np.maximum(slip, TINY))
        mei = np.where(re <= 40, np.exp(-0.1 * re) - 0.3314 * root * np.expm1(-0.1 * re), 0.0524 * root * np.sqrt(re))
        strength = 1.615 * d ** 2 * np.sqrt(fluid.viscosity * fluid.density / np.maximum(turn, TINY)) * mei
        return -(p.number * strength)[:, None] * _cross(fluid.vorticity, fluid.slip)


class MagnusLift:
    """Lift of a spinning particle, pi/8 rho d^2 C |s| Omega x s / |Omega|.

    C = 0.45 + (Re_R/Re - 0.45) exp(-0.05684 Re_R^0.4 Re^0.3) of Oesterle & Bui Dinh, Exp. Fluids 25 (1998) 16, for Re up to
    140; at low Reynolds numbers the force is that of Rubinow & Keller (1961), pi/8 rho d^3 Omega x s.
    """

    needs = ("slip", "vorticity")

    def force(self, fluid: "FluidAtParticles") -> np.ndarray:
        """(particles, d) [N]."""
        p, d = fluid.particles, fluid.particles.primary_diameter
        relative = 0.5 * fluid.vorticity - p.angular_velocity
        turn, slip = _size(relative), _size(fluid.slip)
        viscosity = fluid.viscosity / fluid.density
        left = np.exp(-0.05684 * (turn * d ** 2 / viscosity) ** 0.4 * (slip * d / viscosity) ** 0.3)
        strength = np.pi / 8 * fluid.density * d ** 2 * (0.45 * slip * (1 - left) + d * turn * left)  # times C |s|
        return (p.number * strength / np.maximum(turn, TINY))[:, None] * _cross(relative, fluid.slip)


class Torque:
    """Torque pi mu d^3 f Omega, by which the spin of a particle relaxes to that of the fluid, exactly over any step.

    Of a slowly spinning sphere f = 1 (Rubinow & Keller, J. Fluid Mech. 11 (1961) 447): the time of relaxation is rho_p d^2 /
    (60 mu). For Re_R above 32 f = (12.9 sqrt(Re_R) + 128.4) / (64 pi) (Dennis, Singh & Ingham, J. Fluid Mech. 101 (1980)
    257). The fluid receives the opposite couple.
    """

    needs = ("vorticity",)

    def spin(self, fluid: "FluidAtParticles") -> tuple[np.ndarray, np.ndarray]:
        """Rates (particles,) [1/s] and targets (particles, 3) [1/s] of the angular velocities."""
        p, d, target = fluid.particles, fluid.particles.primary_diameter, 0.5 * fluid.vorticity
        re = fluid.density * _size(target - p.angular_velocity) * d ** 2 / fluid.viscosity
        faster = np.where(re > 32, (12.9 * np.sqrt(re) + 128.4) / (64 * np.pi), 1.0)
        return 60 * fluid.viscosity / (p.density * d ** 2) * faster, target


class Spin:
    """Changes of angular velocities over a step by the forces of a list that have a ``spin``, and the fluid's part of them.

    Rates k and targets of several add up; the angular velocity then changes by (1 - exp(-k dt)) (target - omega), so any
    step is stable. The couple that this takes from the fluid is the force density 1/2 curl t, with t the P1 function of the
    couple per volume, zero on the boundary: its sum is zero to round-off, and its moment is that of t.

    Args:
        mesh: dolfinx mesh.
        forces: with a method ``spin``.

    Note:
        Collective.
    """

    def __init__(self, mesh, forces):
        self.forces, self.nodes = forces, Nodes(mesh)
        nodes = self.nodes
        self.mass = nodes.node_halo.forward(nodes.load(np.ones((len(nodes.dofs), 1))))
        self.inside = inner_nodes(nodes, mesh)

    def over_step(self, fluid):
        """Change of the angular velocities (particles, 3) [1/s], zero if held, and the mean torques (particles, 3) [N m]."""
        p = fluid.particles
        rate, drive = np.zeros(len(p)), np.zeros((len(p), 3))
        for force in self.forces:
            k, target = force.spin(fluid)
            rate, drive = rate + k, drive + np.asarray(k)[:, None] * (target - p.angular_velocity)
        part = np.where(p.held, fluid.span, -np.expm1(-rate * fluid.span) / np.maximum(rate, TINY))[:, None]
        inertia = 0.1 * p.mass * p.primary_diameter ** 2
        return np.where(p.held[:, None], 0.0, part * drive), inertia[:, None] * part / fluid.dt * drive

    def force_of(self, couple):
        """Force density (owned cells, d) of a couple per volume (owned cells, 3) [N m / m^3]."""
        nodes, d = self.nodes, self.nodes.gradient.shape[2]
        t = nodes.node_halo.forward(nodes.load(couple)) / self.mass
        slope = np.einsum("cik,cil->ckl", nodes.gradient, np.where(self.inside[:, None], t, 0.0)[nodes.dofs])  # dt_l/dx_k
        if d == 2:
            return 0.5 * np.column_stack([slope[:, 1, 2], -slope[:, 0, 2]])
        return 0.5 * np.column_stack([slope[:, 1, 2] - slope[:, 2, 1], slope[:, 2, 0] - slope[:, 0, 2],
                                      slope[:, 0, 1] - slope[:, 1, 0]])
