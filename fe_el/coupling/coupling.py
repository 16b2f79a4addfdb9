"""Conservative two-way coupling: particles to three cell fields, and the impulse the fluid really gave back to them."""
import time

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from fe_el.coupling import satellite_points as mapping
from fe_el.coupling.fields import CellMean, PressureGradientMean
from fe_el.coupling.forces import Drag, PressureGradient, momentum_rates
from fe_el.coupling.over_filled import Spill
from fe_el.particles.location import locate


class Coupling:
    """Momentum exchange of particles with any fluid that takes a void fraction, a drag coefficient and a source.

    Over one step of length dt, with beta'_i = rho_p (1 - exp(-dt beta_i / rho_p)) / dt and v*_i the velocity particle i
    would have without drag,

        A_j = sum_i w_ij V_i beta'_i / V_j,   B_j = sum_i w_ij V_i beta'_i v*_i / V_j,

    and after the fluid step particle i receives exactly V_i beta'_i (sum_j w_ij u_j - v*_i) - V_i sum_j w_ij grad p_j per
    time. What particles gain the fluid loses, to round-off, for any dt.

    Args:
        particles (Particles): the particles.
        velocity: the fluid's interstitial velocity, a vector Function [m/s].
        pressure: its pressure, a Function [Pa].
        fluid_density, fluid_viscosity (float): [kg/m^3], [Pa s].
        forces: list of :class:`Drag` and :class:`PressureGradient`.
        points: satellite points (points, 3) in radii; absent: 29 isotropic ones.
        largest_solid_fraction (float): cells that hold more hand the excess to their neighbours, conservatively.

    Attributes:
        fields: (void fraction DG0, drag coefficient A DG0 [kg/(m^3 s)], momentum source B DG0 vector [N/m^3]).
        over_filled (int): cells that were over-filled in the last step, over all ranks.

    Raises:
        ValueError: for an unknown force or a number out of range.

    Note:
        Collective.
    """

    def __init__(self, particles, velocity, pressure, fluid_density, fluid_viscosity, forces, points=None,
                 largest_solid_fraction=0.74):
        for name, value in (("fluid density", fluid_density), ("fluid viscosity", fluid_viscosity)):
            if not (value > 0 and np.isfinite(value)):
                raise ValueError(f"The {name} is {value}; it must be finite and greater than zero.")
        if not 0 < largest_solid_fraction < 1:
            raise ValueError(f"largest_solid_fraction is {largest_solid_fraction}; it must be between 0 and 1.")
        unknown = [f for f in forces if not isinstance(f, (Drag, PressureGradient))]
        if unknown:
            raise ValueError(f"{unknown[0]!r} is no force; forces are Drag(law) and PressureGradient().")
        self.particles, self.comm, mesh = particles, particles.comm, particles.mesh
        self.density, self.viscosity, self.largest = fluid_density, fluid_viscosity, largest_solid_fraction
        self.dimension = d = mesh.topology.dim
        self.drag = next((f for f in forces if isinstance(f, Drag)), None)
        self.pressure_force = any(isinstance(f, PressureGradient) for f in forces)
        self.points = mapping.isotropic_points() if points is None else np.ascontiguousarray(points, float)
        scalar, vector = fem.FunctionSpace(mesh, ("DG", 0)), fem.VectorFunctionSpace(mesh, ("DG", 0))
        self.fields = (fem.Function(scalar, name="void_fraction"), fem.Function(scalar, name="drag_coefficient"),
                       fem.Function(vector, name="momentum_source"))
        self.fields[0].x.array[:] = 1.0
        self.velocity_mean = CellMean(mesh, velocity, d)
        self.gradient_mean = PressureGradientMean(mesh, pressure, particles.cells.barycentric) if self.pressure_force \
            else None
        self.seconds = {"mapping": 0.0, "drag": 0.0}
        self.over_filled, self.over_filled_total, self.solid_volume_error = 0, 0, 0.0
        self.momentum_imbalance, self.max_solid_fraction = 0.0, 0.0

    # -- particles to fluid --------------------------------------------------------------------------------------------

    def to_fluid(self, dt):
        """Map the particles: void fraction, drag coefficient and momentum source for a step of ``dt`` [s].

        Note:
            Collective.
        """
        tick = time.perf_counter()
        p = self.particles
        missing = locate(p.cells, p.cell, p.position)
        if p.comm.allreduce(missing):
            p._search_everywhere()
        self.shares = mapping.shares(p.cells, p.cell, p.position, 0.5 * p.diameter, self.points)
        content = self._deposit(p.volume[:, None])
        self.spill = Spill(p.cells, p.halo, content[:, 0], self.largest)
        self.over_filled = self.comm.allreduce(self.spill.over_filled)
        self.over_filled_total += self.over_filled
        self.solid = self.spill(content)[:, :1] / p.cells.volume[:, None]
        self._solid_ledger()
        self._set(0, 1 - self.solid)
        self.seconds["mapping"] += time.perf_counter() - tick
        tick = time.perf_counter()
        if self.drag is not None:
            self._drag_fields(dt)
        self.seconds["drag"] += time.perf_counter() - tick

    def _drag_fields(self, dt):
        """A and B from the drag of each particle over the coming step."""
        p, d = self.particles, self.dimension
        u = self._gather(self._on_cells(self.velocity_mean()))
        s = self._gather(self.solid)[:, 0]
        predicted = p.gravity + p.mean_contact_force / p.mass[:, None]
        slip = np.linalg.norm(u - p.velocity[:, :d], axis=1)
        beta = self.drag.coefficient(s, slip, p.diameter, self.density, self.viscosity)
        if len(beta) and not (np.isfinite(beta).all() and beta.min() >= 0):
            i = int(np.flatnonzero(~(np.isfinite(beta) & (beta >= 0)))[0])
            raise FloatingPointError(f"The drag law gave {beta[i]:g} for particle {p.id[i]} at solid fraction {s[i]:g} and "
                                     f"slip {slip[i]:g} m/s (step {p.step}, rank {self.comm.rank}); it must be finite "
                                     "and not negative. Check the law's range or use larger cells.")
        self.rate = (p.volume * momentum_rates(beta, p.density, dt))[:, None]
        self.free_velocity = (p.velocity + dt * predicted)[:, :d]
        out = self.spill(self._deposit(np.hstack([self.rate, self.rate * self.free_velocity]))) \
            / p.cells.volume[:, None]
        self._set(1, out[:, :1])
        self._set(2, out[:, 1:])

    # -- fluid to particles --------------------------------------------------------------------------------------------

    def to_particles(self, dt):
        """Give the particles the impulse of the fluid over the step just made, as a force over the next ``dt`` [s].

        Note:
            Collective.
        """
        tick = time.perf_counter()
        p, d = self.particles, self.dimension
        force = np.zeros((len(p), 3))
        volume = p.cells.volume[:p.cells.owned, None]
        received = np.zeros(d)
        if self.drag is not None:
            u = self.velocity_mean()
            force[:, :d] += self.rate * (self._gather(self._on_cells(u)) - self.free_velocity)
            a, b = self.fields[1].x.array[:len(volume), None], self.fields[2].x.array.reshape(-1, d)[:len(volume)]
            received += (volume * (b - a * u)).sum(0)
        if self.pressure_force:
            slope = self.gradient_mean()
            force[:, :d] -= p.volume[:, None] * self._gather(self._on_cells(slope))
            received += (volume * (1 - self.fields[0].x.array[:len(volume), None]) * slope).sum(0)
        p.force = force
        given, received = self.comm.allreduce(force[:, :d].sum(0)), self.comm.allreduce(received)
        weight = self.comm.allreduce(p.mass.sum()) * max(np.linalg.norm(p.gravity), 1e-300)
        scale = weight if np.linalg.norm(p.gravity) > 0 else max(np.linalg.norm(given), 1e-300)
        self.momentum_imbalance = float(np.abs(given + received).max() / scale)
        self.seconds["drag"] += time.perf_counter() - tick

    # -- maps ----------------------------------------------------------------------------------------------------------

    def _deposit(self, quantity):
        """Cell totals (cells, k) of particle quantities, complete on owned and halo cells."""
        p = self.particles
        out = np.zeros((len(p.cells.volume), quantity.shape[1]))
        mapping.deposit(*self.shares, np.ascontiguousarray(quantity), out)
        return p.halo.forward(p.halo.reverse_add(out))

    def _on_cells(self, owned):
        """Owned cell values continued to the halo."""
        p = self.particles
        out = np.zeros((len(p.cells.volume), owned.shape[1]))
        out[:len(owned)] = owned
        return p.halo.forward(out)

    def _gather(self, field):
        """Particle means of a cell field: the transpose of deposit and spill."""
        out = np.empty((len(self.particles), field.shape[1]))
        mapping.gather(*self.shares, self.spill.transpose(field), out)
        return out

    def _set(self, which, values):
        function, n = self.fields[which], self.particles.cells.owned
        function.x.array[:n * values.shape[1]] = values[:n].ravel()
        function.x.scatter_forward()

    def _solid_ledger(self):
        """Solid volume on the cells against that of the particles, and the fullest cell."""
        p, n = self.particles, self.particles.cells.owned
        cells = self.comm.allreduce(float(self.solid[:n, 0] @ p.cells.volume[:n]))
        particles = self.comm.allreduce(float(p.volume.sum()))
        self.solid_volume_error = abs(cells - particles) / max(particles, 1e-300)
        self.max_solid_fraction = self.comm.allreduce(self.solid[:n, 0].max(initial=0.0), op=MPI.MAX)
