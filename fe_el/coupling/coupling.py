"""Two-way coupling: particles to three cell fields, and the impulse the fluid really gave back to them."""
import math
import time

import numpy as np
from dolfinx import fem

from fe_el.coupling import mapping as _mapping
from fe_el.coupling import particle_loops as loops
from fe_el.coupling.fields import CellMean, PressureGradientMean, ViscousStressMean
from fe_el.coupling.forces import FORCES
from fe_el.coupling.over_filled import Spill
from fe_el.coupling.schemes import Exchange, scheme_of
from fe_el.coupling.smoothing import FixedValues
from fe_el.dolfinx_api import scalar_space, vector_space
from fe_el.exchange import largest_of, raise_everywhere, sums_of
from fe_el.fluid.work_arrays import WorkArrays

LIQUID = 0.1  # density of a fluid over that of the particles, from which its answer to displaced volume drives them


class Coupling:
    """Momentum exchange of particles with any fluid that takes a void fraction, a drag coefficient and a source.

    Particles give their volume, drag and momentum to cells through the shares of a mapping, the excess of over-filled cells
    goes to their neighbours, and a self-adjoint smoothing spreads the result; what cells give back to particles passes the
    transpose of the same map. So with the ``conservative`` scheme what particles gain the fluid loses, to round-off.

    Args:
        particles (Particles): the particles.
        velocity: the fluid's interstitial velocity, a vector Function or UFL expression [m/s]. Of a fluid that particles do
            not
            change, set by the script: that of the middle of the step.
        pressure: its pressure, of the middle of the step, a Function or UFL expression [Pa].
        fluid_density, fluid_viscosity (float): [kg/m^3], [Pa s].
        forces: list of :class:`Drag`, :class:`PressureGradient`, :class:`ViscousStress`, :class:`Buoyancy`.
        scheme (str): ``conservative``, ``explicit``, ``implicit``, ``implicit_from_force``, ``split`` or
            ``void_cells_explicit``.
        mapping: ``overlap_volume``, ``satellite_points`` (the paper's), ``cfdem_points``, ``particle_centred``, ``hat``,
            ``well_mixed``, or an object (see :mod:`fe_el.coupling.mapping`).
        smoothing: :class:`HelmholtzSmoothing`, :class:`PatchAverage` or another self-adjoint map of cell fields; absent:
            none.
        fluid_velocity (str): velocity at the particle: ``cell`` means, or ``linear`` interpolation between vertices; the
            difference of the two lags by a step, and momentum stays exact.
        largest_solid_fraction (float): cells that hold more hand the excess to their neighbours, conservatively.
        positions (str): the particles' positions that are mapped: of the ``start`` of the step, or of its ``middle``;
            absent: of
            the middle, but where a fluid answers: of the start in a liquid, whose answer to what particles displace would be
                fed
            back by places ahead, and earlier than the middle in one step of a Courant number above 1, from 4 on of the
            start.
        mean_velocity: mean of the velocity that drag acted on in the step, for a fluid that makes several of its own (as
            :class:`SubCycled`, with its mean pressure for ``pressure``); absent: ``velocity``.

    Attributes:
        fields: (void fraction DG0, drag coefficient A DG0 [kg/(m^3 s)], momentum source B DG0 vector [N/m^3]).
        over_filled (int): cells that were over-filled in the last step, over all ranks.
        solid_volume_error, momentum_imbalance (float): ledger of the last step, relative to the solid volume and to the
            particles' weight (without gravity: to the force).
        max_solid_fraction (float): in the last step.

    Raises:
        ValueError: for an unknown force, scheme or mapping, or a number out of range.

    Note:
        Collective.
    """

    def __init__(self, particles, velocity, pressure, fluid_density, fluid_viscosity, forces, scheme="conservative",
                 mapping="overlap_volume", smoothing=None, fluid_velocity="cell", largest_solid_fraction=0.74,
                 positions=None, mean_velocity=None):
        for name, value in (("fluid density", fluid_density), ("fluid viscosity", fluid_viscosity)):
            if not (value > 0 and np.isfinite(value)):
                raise ValueError(f"The {name} is {value}; it must be finite and greater than zero.")
        if not 0 < largest_solid_fraction < 1:
            raise ValueError(f"largest_solid_fraction is {largest_solid_fraction}; it must be between 0 and 1.")
        if fluid_velocity not in ("cell", "linear"):
            raise ValueError(f"fluid_velocity is {fluid_velocity!r}; use 'cell' or 'linear'.")
        if positions not in (None, "start", "middle"):
            raise ValueError(f"positions is {positions!r}; use 'start' or 'middle', or leave it out.")
        unknown = [f for f in forces if not isinstance(f, FORCES)]
        if unknown:
            raise ValueError(f"{unknown[0]!r} is no force; forces are Drag(law), PressureGradient(), ViscousStress() and "
                             "Buoyancy().")
        self.particles, self.comm, mesh = particles, particles.comm, particles.mesh
        self.density, self.viscosity, self.largest = fluid_density, fluid_viscosity, largest_solid_fraction
        self.dimension, self.answers = mesh.topology.dim, None  # whether the fluid changed in the last step
        self.ahead = {"start": 0.0, "middle": 0.5, None: None if mean_velocity is None else 0.5}[positions]
        d = self.dimension
        self.drag, self.pressure_force, viscous, self.buoyancy = (
            next((f for f in forces if isinstance(f, kind)), None) for kind in FORCES)
        self.mapping, self.smoothing, self.scheme = _mapping.mapping_of(mapping), smoothing, scheme_of(scheme)
        self.linear = _mapping.LinearInterpolation() if fluid_velocity == "linear" else None
        scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
        self.fields = (fem.Function(scalar, name="void_fraction"), fem.Function(scalar, name="drag_coefficient"),
                       fem.Function(vector, name="momentum_source"))
        self.fields[0].x.array[:] = 1.0
        self.velocity_mean = self.step_mean = CellMean(mesh, velocity, d)
        if mean_velocity is not None:
            self.step_mean = CellMean(mesh, mean_velocity, d)
        self.gradient_mean = PressureGradientMean(mesh, pressure,
                                                  particles.cells.barycentric) if self.pressure_force else None
        self.stress_mean = ViscousStressMean(mesh, fluid_viscosity) if viscous else None
        length = getattr(smoothing, "length", None)
        self.fixed = FixedValues(mesh, length) if length and scheme in ("implicit", "implicit_from_force") else None
        self.seconds = {"mapping": 0.0, "drag": 0.0}
        if smoothing is not None:
            self.seconds["smoothing"] = 0.0
        self._kept, self._mapped, self._work, self._none = None, None, WorkArrays(), np.zeros((0, d))
        self.over_filled, self.over_filled_total, self.solid_volume_error = 0, 0, 0.0
        self.momentum_imbalance, self.max_solid_fraction = 0.0, 0.0

    # -- particles to fluid --------------------------------------------------------------------------------------------

    def to_fluid(self, dt):
        """Map the particles: void fraction, drag coefficient and momentum source for a step of ``dt`` [s].

        Note:
            Collective.
        """
        tick = self._begin()
        p = self.particles
        self._steady = np.zeros(self.dimension)  # force per volume that needs no field
        if self.pressure_force is not None:
            self._steady += self.pressure_force.mean[:self.dimension]
        if self.buoyancy is not None:
            self._steady -= self.density * p.gravity[:self.dimension]
        self.cell_velocity = self.velocity_mean().copy()
        if not self._as_before():
            self._map(dt)
        self._end("mapping", tick)
        tick = self._begin()
        self.explicit_reaction = self._none
        if self.stress_mean is not None:
            stress = self._gather(self._back(self.stress_mean(self.cell_velocity)))
            self.explicit_reaction = self.volume * stress
        if self.drag is not None:
            self._drag_fields(dt)
        elif self.stress_mean is not None:
            self._set(2, -self._to_cells(self.explicit_reaction))
        self._end("drag", tick)

    def _as_before(self):
        """Whether all particles are held and where they were when they were mapped."""
        p, same = self.particles, False
        if not p.all_held():
            self._mapped = None
            return False
        now = p.cells, p.position, p.diameter
        if self._mapped is not None:
            same = self._mapped[0] is now[0] and all(np.array_equal(a, b) for a, b in zip(self._mapped[1:], now[1:]))
        self._mapped = p.cells, p.position.copy(), p.diameter.copy()
        return self.comm.allreduce(int(same)) == self.comm.size

    def _share_ahead(self, dt):
        """Share of the step after which places are taken; see ``positions``."""
        if self.ahead is not None:
            return self.ahead
        if self.answers is False:
            return 0.5
        cells, d = self.particles.cells, self.dimension
        volume = cells.volume[:cells.owned] / (self.particles.thickness if d == 2 else 1.0)
        speed = np.sqrt((self.cell_velocity ** 2).sum(1))
        courant = dt * (speed / (math.factorial(d) * volume) ** (1 / d)).max(initial=0.0)
        density = self.density / self.particles.density.min(initial=np.inf)
        courant, density = largest_of(self.comm, courant, density)
        if density > LIQUID:
            return 0.0
        return 0.5 * float(np.clip((4 - courant) / 3, 0.0, 1.0))

    def _map(self, dt):
        """Shares of the cells in every particle, and the void fraction."""
        p = self.particles
        self.position_cell, position = p.located(self._share_ahead(dt) * dt)
        self.volume = self._work.empty("volume", len(p), 1)
        volume = loops.volumes(p.diameter, self.volume)
        self.mapping.prepare(p.cells, self.position_cell, position, 0.5 * p.diameter)
        if self.linear is not None:
            self.linear.prepare(p.cells, self.position_cell, position, 0.5 * p.diameter)
        content = self._volumes(self._smooth(self._deposit(self.volume)[:p.cells.owned] / self._owned_volume()))
        self.spill = Spill(p.cells, p.halo, content[:, 0], self.largest)
        self.over_filled = self.spill.over_filled_everywhere
        self.over_filled_total += self.over_filled
        self.solid = self.spill(content)[:, :1] / p.cells.volume[:, None]
        self._solid_ledger(volume)
        self._set(0, 1 - self.solid)

    def _drag_fields(self, dt):
        """A and B from the drag of each particle over the coming step."""
        p, d = self.particles, self.dimension
        cell_velocity, n, velocity = self.cell_velocity, p.cells.owned, p.velocity[:, :d]
        back, offset = self._old_velocity(cell_velocity), None
        mean = self._gather(np.hstack([self.solid, back]), "solid_and_velocity")
        if self.linear is not None:
            linear = self._work.empty("linear", len(p), d)
            self.linear.gather(back, linear)
            offset = linear - mean[:, 1:]
            mean[:, 1:] = linear
        solid, slip = self._work.empty("solid", len(p)), self._work.empty("slip", len(p))
        loops.fluid_at_particles(mean, velocity, solid, slip)
        beta = self._coefficient(solid, slip)
        inertia, acceleration = self._accelerations()
        exchange = Exchange(dt, self.volume, inertia, velocity, acceleration, beta[:, None], mean[:, 1:], offset,
                            self._to_cells,
                            lambda q: self._deposit(q)[:n], cell_velocity, self.fixed or (lambda field, filled: field))
        a, b = self.scheme.fields(exchange)
        if self.stress_mean is not None:
            b = b - self._to_cells(self.explicit_reaction)
        self._set(1, a)
        self._set(2, b)

    def _coefficient(self, solid, slip):
        """Drag coefficient of each particle, checked."""
        p, sauter = self.particles, None
        if self.drag.polydisperse:
            sizes = np.hstack([self.volume, self.volume / p.primary_diameter[:, None]])
            sums = self._gather(self._on_cells(self._to_cells(sizes)))
            sauter = sums[:, 0] / sums[:, 1]
        beta = self.drag.coefficient(solid, slip, p.primary_diameter, self.density, self.viscosity, sauter)
        i, message = loops.first_bad(beta), None
        if i >= 0:
            message = (f"The drag law gave {beta[i]:g} for particle {p.id[i]} at solid fraction {solid[i]:g} and slip "
                       f"{slip[i]:g} m/s (step {p.step}, rank {self.comm.rank}); it must be finite and not negative. Check "
                       f"the "
                       "law's range or use larger cells.")
        raise_everywhere(self.comm, FloatingPointError, message)
        return beta

    def _accelerations(self):
        """Densities (particles, 1), infinite if held, and accelerations (particles, d): by gravity, the last mean contact
        force,
        and the other forces of the fluid as of the last step."""
        p, n = self.particles, len(self.particles)
        inertia, acceleration = self._work.empty("inertia", n, 1), self._work.empty("acceleration", n, self.dimension)
        loops.accelerations(p.held, self.volume, p.density, p.gravity, self._steady, p.mean_contact_force,
                            self.explicit_reaction,
                            p.properties.get("_pressure_gradient", self._none), inertia, acceleration)
        return inertia, acceleration

    # -- fluid to particles --------------------------------------------------------------------------------------------

    def to_particles(self, dt):
        """Give the particles the impulse of the fluid over the step just made, as a force over the next ``dt`` [s].

        Note:
            Collective.
        """
        tick = self._begin()
        p, d, volume = self.particles, self.dimension, self._owned_volume()
        a, b = self.fields[1].x.array[:len(volume), None], self.fields[2].x.array.reshape(-1, d)[:len(volume)]
        u = self.step_mean()
        received, changed = (volume * (b - a * u)).sum(0), self.ahead is None and not np.array_equal(u, self.cell_velocity)
        slope = self.gradient_mean() if self.pressure_force is not None else np.zeros((len(volume), 0))
        back = self._back(np.hstack([u, slope]))
        self._kept = (u.copy(), back[:, :d]) if not self.spill.moves else None
        at_particles, drag = self._gather(back, "velocity_and_slope"), self._none
        if self.drag is not None:
            drag = self.scheme.force(at_particles[:, :d])
        p.relaxation_rate[:] = self.scheme.relaxation_rate if self.drag is not None else 0.0
        gradient = self._none
        if self.pressure_force is not None:
            received += (volume * (1 - self.fields[0].x.array[:len(volume), None]) * slope).sum(0)
            gradient = p.properties.setdefault("_pressure_gradient", np.empty((len(p), d)))
        given, mass = loops.total_force(self.volume, p.density, self._steady, drag, self.explicit_reaction,
                                        at_particles[:, d:],
                                        gradient, p.force)
        self._momentum_ledger(given, received, mass, changed)
        self._end("drag", tick)

    def _momentum_ledger(self, given, received, mass, changed):
        """What particles and fluid gained against each other, and whether the fluid changed anywhere in the step."""
        p, d = self.particles, self.dimension
        sums = sums_of(self.comm, *given, *(given + received), mass, changed)
        self.answers = bool(sums[-1] > 0)
        weight = sums[-2] * np.linalg.norm(p.gravity)
        self.momentum_imbalance = float(np.abs(sums[d:2 * d]).max() / (weight or max(np.linalg.norm(sums[:d]), 1e-300)))

    # -- maps ----------------------------------------------------------------------------------------------------------

    def _begin(self):
        return time.perf_counter(), self.seconds.get("smoothing", 0.0)

    def _end(self, stage, tick):
        """Book the time of a stage, less the smoothing inside it."""
        self.seconds[stage] += time.perf_counter() - tick[0] - (self.seconds.get("smoothing", 0.0) - tick[1])

    def _owned_volume(self):
        cells = self.particles.cells
        return cells.volume[:cells.owned, None]

    def _smooth(self, field):
        """Smoothing of owned cell values; the identity without."""
        if self.smoothing is None:
            return field
        tick = time.perf_counter()
        out = self.smoothing(np.ascontiguousarray(field))
        self.seconds["smoothing"] += time.perf_counter() - tick
        return out

    def _deposit(self, quantity):
        """Cell totals (cells, k) of particle quantities, complete on owned and halo cells."""
        p = self.particles
        out = np.zeros((len(p.cells.volume), quantity.shape[1]))
        self.mapping.deposit(np.ascontiguousarray(quantity), out)
        return p.halo.forward(p.halo.reverse_add(out))

    def _volumes(self, density):
        """Cell totals on owned and halo cells from densities on owned ones."""
        return self._on_cells(density) * self.particles.cells.volume[:, None]

    def _to_cells(self, quantity):
        """Cell densities (owned cells, k) of particle quantities: mapped, smoothed, spilled."""
        n = self.particles.cells.owned
        if self.smoothing is None:
            return self.spill(self._deposit(quantity))[:n] / self._owned_volume()
        return self.spill(self._volumes(self._smooth(self._deposit(quantity)[:n] / self._owned_volume())))[:n] \
            / self._owned_volume()

    def _back(self, field):
        """Owned cell values made ready for particles: spilled back, then smoothed; the transpose of :meth:`_to_cells`."""
        out = self.spill.transpose(self._on_cells(field))
        return out if self.smoothing is None else self._on_cells(self._smooth(out[:len(field)]))

    def _old_velocity(self, velocity):
        """The cell velocity made ready for particles; what the last step smoothed serves again if nothing was spilled."""
        if self._kept is None or self.spill.moves:
            return self._back(velocity)
        same = np.array_equal(self._kept[0], velocity) and len(self._kept[1]) == len(self.particles.cells.volume)
        if self.comm.allreduce(int(same)) < self.comm.size:
            return self._back(velocity)
        return np.ascontiguousarray(self._kept[1])

    def _on_cells(self, owned):
        """Owned cell values continued to the halo."""
        p = self.particles
        out = np.zeros((len(p.cells.volume), owned.shape[1]))
        out[:len(owned)] = owned
        return p.halo.forward(out)

    def _gather(self, field, name="field"):
        """Particle means of a field on owned and halo cells, in the array that is kept for the name."""
        out = self._work.empty(name, len(self.particles), field.shape[1])
        self.mapping.gather(field, out)
        return out

    def _set(self, which, values):
        function, n = self.fields[which], self.particles.cells.owned
        function.x.array[:n * values.shape[1]] = values[:n].ravel()
        function.x.scatter_forward()

    def _solid_ledger(self, volume):
        """Solid volume on the cells against ``volume`` of this rank's particles, and the fullest cell."""
        cells, n = self.particles.cells, self.particles.cells.owned
        on_cells, of_particles = sums_of(self.comm, self.solid[:n, 0] @ cells.volume[:n], volume)
        self.solid_volume_error = abs(on_cells - of_particles) / max(of_particles, 1e-300)
        self.max_solid_fraction = float(largest_of(self.comm, self.solid[:n, 0].max(initial=0.0))[0])
