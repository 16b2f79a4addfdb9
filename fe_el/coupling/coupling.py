"""Two-way coupling: particles to three cell fields, and the impulse the fluid really gave back to them."""
import math
import time
import warnings

import numpy as np
from dolfinx import fem

from fe_el.checks import function_or_class_of, positive_number, same_mesh
from fe_el.coupling import mapping as _mapping
from fe_el.coupling import particle_loops as loops
from fe_el.coupling.added_mass import AddedMass, AddedMassExchange
from fe_el.coupling.fields import CellMean, PressureGradientMean
from fe_el.coupling.fitting import fitting, step_beyond_sense
from fe_el.coupling.fluid_at_particles import METHODS, AskedOfFluid, FluidAtParticles, check_force, given
from fe_el.coupling.forces import Buoyancy, Drag, PressureGradient
from fe_el.coupling.lift_and_torque import Spin
from fe_el.coupling.maps import Maps
from fe_el.coupling.over_filled import Spill
from fe_el.coupling.relaxing_slip import over_step
from fe_el.coupling.schemes import Exchange, Explicit, scheme_of
from fe_el.coupling.smoothing import FixedValues
from fe_el.coupling.undisturbed import OwnVelocity, UndisturbedVelocity
from fe_el.dolfinx_api import scalar_space, vector_space
from fe_el.nodes.work_arrays import WorkArrays
from fe_el.parallel.exchange import largest_of, raise_everywhere, sums_of

LIQUID = 0.1  # density of a fluid over that of the particles, from which its answer to displaced volume drives them


class Coupling(Maps):
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
        forces: list of :class:`Drag`, :class:`PressureGradient`, :class:`ViscousStress`, :class:`Buoyancy`,
            :class:`UndisturbedVelocity`, :class:`AddedMass` (there by itself if particles are less than 1.4 times as dense
            as the fluid), and of own ones: objects that say what they need of the fluid and give a force (see
            :mod:`fe_el.coupling.fluid_at_particles`).
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
        fields: (void fraction DG0, drag coefficient A DG0 [kg/(m^3 s)], momentum source B DG0 vector [N/m^3]); with added
            mass also the share DG0 of the pressure gradient that particles hand on to the fluid.
        over_filled (int): cells that were over-filled in the last step, over all ranks.
        solid_volume_error, momentum_imbalance (float): ledger of the last step, relative to the solid volume and to the
            particles' weight, that of added mass included (without gravity: to the force).
        max_solid_fraction (float): in the last step.

    Raises:
        ValueError: for an unknown force, scheme or mapping, or a number out of range.

    Note:
        Collective.
    """

    def __init__(self, particles, velocity, pressure, fluid_density, fluid_viscosity, forces, scheme="conservative",
                 mapping="overlap_volume", smoothing=None, fluid_velocity="cell", largest_solid_fraction=0.74,
                 positions=None, mean_velocity=None):
        if not hasattr(particles, "relaxation_rate") or isinstance(particles, type):
            raise ValueError(f"The particles are {particles!r}; pass an object of Particles.")
        for name, function in (("velocity", velocity), ("pressure", pressure), ("mean velocity", mean_velocity)):
            if not hasattr(function, "ufl_shape") and (function is not None or name == "velocity"):
                raise ValueError(f"The {name} of the fluid is {function!r}; pass its Function, or a UFL expression.")
            same_mesh(f"values of the {name}", function, particles.mesh)
        fluid_density = positive_number("fluid density", fluid_density)
        fluid_viscosity = positive_number("fluid viscosity", fluid_viscosity)
        if not 0 < positive_number("largest_solid_fraction", largest_solid_fraction) < 1:
            raise ValueError(f"largest_solid_fraction is {largest_solid_fraction}; it must be between 0 and 1.")
        if fluid_velocity not in ("cell", "linear"):
            raise ValueError(f"fluid_velocity is {fluid_velocity!r}; use 'cell' or 'linear'.")
        if positions not in (None, "start", "middle"):
            raise ValueError(f"positions is {positions!r}; use 'start' or 'middle', or leave it out.")
        if not isinstance(forces, (list, tuple)):
            raise ValueError(f"The forces are {forces!r}; give a list, for instance [Drag('beetstra'), PressureGradient()].")
        built_in = Drag, PressureGradient, Buoyancy, AddedMass, UndisturbedVelocity
        twice = [kind.__name__ for kind in built_in if sum(isinstance(f, kind) for f in forces) > 1]
        if twice:
            raise ValueError(f"The forces hold {twice[0]} more than once; give each kind of force once.")
        others = [f for f in forces if not isinstance(f, built_in)]
        for force in others:
            check_force(force)
        if smoothing is not None:
            function_or_class_of("smoothing", smoothing, "for instance HelmholtzSmoothing(mesh, length), or leave it out")
        self.particles, self.comm, mesh = particles, particles.comm, particles.mesh
        self.density, self.viscosity, self.largest = fluid_density, fluid_viscosity, largest_solid_fraction
        self.dimension, self.answers = mesh.topology.dim, None  # whether the fluid changed in the last step
        self.ahead = {"start": 0.0, "middle": 0.5, None: None if mean_velocity is None else 0.5}[positions]
        d = self.dimension
        self.drag, self.pressure_force, self.buoyancy, law, undisturbed = (
            next((f for f in forces if isinstance(f, kind)), None) for kind in built_in)
        self.others = {method: [f for f in others if hasattr(f, method)] for method in METHODS}
        self.others = {method: found for method, found in self.others.items() if found}
        self.added = self._added_mass(law, scheme, mean_velocity)
        if self.drag is not None and self.drag.relaxing and (scheme != "conservative" or self.added is not None):
            raise ValueError("Drag(relaxing=True) needs scheme='conservative', and particles without added mass.")
        self.drags, self.reacts = self.drag is not None or self.added is not None or "drag_coefficient" in self.others, bool(
            {"force", "spin"} & set(self.others))
        self.mapping, self.smoothing, self.scheme = _mapping.mapping_of(mapping), smoothing, scheme_of(scheme)
        self.own = None if undisturbed is None else self._own_velocity()
        self.linear = _mapping.LinearInterpolation() if fluid_velocity == "linear" else None
        scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
        self.fields = (fem.Function(scalar, name="void_fraction"), fem.Function(scalar, name="drag_coefficient"),
                       fem.Function(vector, name="momentum_source"))
        if self.added is not None:
            self.fields += (fem.Function(scalar, name="pressure_share"),)
        self.fields[0].x.array[:] = 1.0
        self.velocity_mean = self.step_mean = CellMean(mesh, velocity, d)
        if mean_velocity is not None:
            self.step_mean = CellMean(mesh, mean_velocity, d)
        needs = {name for force in others for name in getattr(force, "needs", ())}
        self.gradient_mean = self.asked = None
        if self.pressure_force or "pressure_gradient" in needs:
            if pressure is None:
                raise ValueError("The pressure of the fluid is None, but a force needs its gradient; pass its Function, or "
                                 "a UFL expression.")
            self.gradient_mean = PressureGradientMean(mesh, pressure, particles.cells.barycentric)
        if others:
            self.asked = AskedOfFluid(mesh, needs, fluid_viscosity, self.gradient_mean)
        self.spin = Spin(mesh, self.others["spin"]) if "spin" in self.others else None
        length = getattr(smoothing, "length", None)
        self.fixed = FixedValues(mesh, length) if length and scheme in ("implicit", "implicit_from_force") else None
        self.seconds = {"mapping": 0.0, "drag": 0.0}
        if smoothing is not None:
            self.seconds["smoothing"] = 0.0
        cells, thickness = particles.cells, particles.thickness if d == 2 else 1.0
        self._cell_size = (math.factorial(d) * cells.volume[:cells.owned] / thickness) ** (1 / d)
        self._dt, self.of_way = None, 1.0  # of the last to_fluid; rate of the particles' ways over that of their velocities
        self._kept, self._mapped, self._work, self._none, self.layout = None, None, WorkArrays(), np.zeros((0, d)), None
        self.steps_to_check = 0  # until the step is checked again; less: never
        self.over_filled, self.over_filled_total, self.solid_volume_error = 0, 0, 0.0
        self.momentum_imbalance, self.max_solid_fraction = 0.0, 0.0

    @classmethod
    def of(cls, fluid, particles, forces, **kwargs):
        """The coupling of a fluid and particles that fit each other.

        Velocity, pressure, density and viscosity are the fluid's, and so is the mean of a :class:`PressureGradient` that was
        given none; of a :class:`SubCycled` fluid the means of its steps.

        Args:
            fluid: :class:`VolumeAveragedNavierStokes` or :class:`SubCycled`.
            particles (Particles), forces, kwargs: as for :class:`Coupling`.

        Raises:
            ValueError: where fluid, particles and forces contradict each other.

        Note:
            Collective.
        """
        flow = getattr(fluid, "fluid", fluid)
        if isinstance(fluid, type) or not hasattr(flow, "pressure") or not hasattr(flow, "viscosity"):
            raise ValueError(f"The fluid is {fluid!r}; pass an object of VolumeAveragedNavierStokes or SubCycled.")
        if flow is not fluid:
            kwargs = {"mean_velocity": fluid.mean_velocity, **kwargs}
        pressure, forces = flow.pressure if flow is fluid else fluid.mean_pressure, fitting(flow, particles, forces)
        return cls(particles, flow.velocity, pressure, flow.density, flow.viscosity, forces, **kwargs)

    def saved(self):
        """Whether the fluid answers, and the count of over-filled cells, for a checkpoint."""
        answers = -1 if self.answers is None else int(self.answers)
        return {"same": (None, {"answers": answers, "over_filled_total": self.over_filled_total})}

    def restore(self, state):
        """Take them back."""
        answers = int(state["same"]["answers"])
        self.answers = None if answers < 0 else bool(answers)
        self.over_filled_total, self._kept, self._mapped = int(state["same"]["over_filled_total"]), None, None

    def _added_mass(self, law, scheme, mean_velocity):
        """The exchange with added mass: if a law is given, or where particles are so light that without one they explode."""
        message = None
        if law is None and self._too_light():
            law = AddedMass()
        if law is None:
            return None
        if scheme != "conservative":
            message = f"Added mass, which particles as light as the fluid need, needs scheme='conservative', not {scheme!r}."
        elif mean_velocity is not None:
            message = "Added mass and several steps of the fluid in one (mean_velocity) do not go together."
        raise_everywhere(self.comm, ValueError, message)
        return AddedMassExchange(law, self.pressure_force is not None)

    def _own_velocity(self):
        """What takes a particle's own part off the fluid velocity that drag sees.

        Raises:
            ValueError: where that part is not known.
        """
        if self.dimension != 3:
            raise ValueError("The undisturbed velocity is known in three dimensions only.")
        if not hasattr(self.mapping, "concentration"):
            raise ValueError(f"The undisturbed velocity needs a mapping that lists its shares, not {self.mapping!r}.")
        return OwnVelocity(self.density, self.viscosity, self.smoothing)

    def _too_light(self):
        """Whether the pressure force on a particle that is here, or of the density of those to come, is unstable without
        added mass, in the fullest cells."""
        p = self.particles
        lightest = min(p.default_density, -largest_of(self.comm, -p.density.min(initial=np.inf))[0])
        self.checked = p.next_id
        return self.pressure_force is not None and lightest < self.density * self.largest / (2 * (1 - self.largest))

    # -- particles to fluid --------------------------------------------------------------------------------------------

    def to_fluid(self, dt):
        """Map the particles: void fraction, drag coefficient and momentum source for a step of ``dt`` [s].

        Note:
            Collective.
        """
        self._dt = positive_number("time step", dt)
        tick = self._begin()
        p = self.particles
        if self.added is None and p.next_id != self.checked and self._too_light():
            raise ValueError(f"Particles came that are too light for a pressure force without added mass in a fluid of "
                             f"{self.density:g} kg/m^3; give forces=[..., AddedMass()].")
        self._steady = np.zeros(self.dimension)  # force per volume that needs no field
        if self.pressure_force is not None:
            self._steady += self.pressure_force.mean[:self.dimension]
        if self.buoyancy is not None:
            self._steady -= self.density * p.gravity[:self.dimension]
        self.cell_velocity = self.velocity_mean().copy()
        if not self._as_before():
            self._map(dt)
        self.layout = p.layout
        self._end("mapping", tick)
        tick = self._begin()
        self._ask(dt)
        if self.drags:
            self._drag_fields(dt)
        elif self.reacts:
            self._set(2, self._reaction())
        self._end("drag", tick)

    def _ask(self, dt):
        """Let the forces of the open list see the fluid, and add up those that they give."""
        self.at_fluid, self.explicit_reaction = None, self._none
        if self.asked is None:
            return
        p, d = self.particles, self.dimension
        back = self._back(self.asked.columns(self.cell_velocity))
        means = self._gather(back, "asked")
        if self.linear is not None and self.asked.velocity:
            self.linear.gather(np.ascontiguousarray(back[:, :d]), means[:, :d])
        solid = self._gather(self.solid, "solid_of_forces") if self.asked.solid else None
        self.at_fluid = FluidAtParticles(p, dt, self.density, self.viscosity, self.volume[:, 0],
                                         self.asked.quantities(means, solid, p.velocity[:, :d]))
        if "force" in self.others:
            self.explicit_reaction = np.zeros((len(p), d))
            for force in self.others["force"]:
                self.explicit_reaction += given(force, "force", self.at_fluid, (len(p), d))
        if self.spin is not None:
            self.turn, self.torque = self.spin.over_step(self.at_fluid)

    def _reaction(self):
        """Momentum source (owned cells, d) by the forces of the open list: the opposite of what particles get."""
        source = 0.0
        if "force" in self.others:
            source -= self._to_cells(self.explicit_reaction)
        if self.spin is not None:
            source -= self.spin.force_of(self._to_cells(self.torque))
        return source

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
        courant = loops.largest_courant(self.cell_velocity, self._cell_size, dt)
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
        if self.own is not None:
            own = self.own.now(p, d)
            mean[:, 1:] -= own
        solid, slip = self._work.empty("solid", len(p)), self._work.empty("slip", len(p))
        loops.fluid_at_particles(mean, velocity, solid, slip)
        if self.own is not None:
            volume = p.cells.volume
            solid = self.own.around(p, self.mapping.concentration(volume), self._gather(volume[:, None]), solid, slip)
        beta = self._coefficient(solid, slip, dt)
        if self.own is not None:
            ahead = self.own.ahead(dt, p, beta)
            mean[:, 1:] += own - ahead
            offset = -ahead if offset is None else offset - ahead
        inertia, acceleration = self._accelerations()
        self.exchange = Exchange(dt, self.volume, inertia, velocity, acceleration, beta[:, None], mean[:, 1:], offset,
                                 self._to_cells, lambda q: self._deposit(q)[:n], cell_velocity,
                                 self.fixed or (lambda field, filled: field), p.late)
        a, b = self.scheme.fields(self.exchange) if self.added is None else self._fields_with_added_mass(solid)
        if self.reacts:
            b = b + self._reaction()
        if self.steps_to_check == 0:
            self._check_step(dt, beta)
        self.steps_to_check -= 1
        self._set(1, a)
        self._set(2, b)

    def _check_step(self, dt, beta):
        """Warn once of a step far beyond sense; in the first step and then every hundredth."""
        p, n = self.particles, self.particles.cells.owned
        in_cells = self._to_cells(self.volume * beta[:, None])[:, 0] / (self.density * (1 - self.solid[:n, 0]))
        rates = largest_of(self.comm, in_cells.max(initial=0.0), np.where(p.held, 0.0, beta / p.density).max(initial=0.0))
        message = step_beyond_sense(dt, *rates, type(self.scheme) is Explicit)
        self.steps_to_check = -1 if message else 100
        if message and self.comm.rank == 0:
            warnings.warn(message, RuntimeWarning, stacklevel=4)

    def _fields_with_added_mass(self, solid):
        """The same, and the share of the pressure gradient that particles hand on to the fluid."""
        rows, self.late = self.added.fields(self.exchange, self.particles, solid, self.density)
        out = self._to_cells(np.hstack([rows[:, :2], self.late - rows[:, 2:]]))
        self._set(3, out[:, 1:2])
        return out[:, :1], out[:, 2:]

    def _coefficient(self, solid, slip, dt):
        """Drag coefficient of each particle, checked."""
        p, beta = self.particles, np.zeros(len(self.particles)) if self.drag is None else self._by_law(solid, slip, dt)
        for force in self.others.get("drag_coefficient", ()):
            beta = beta + given(force, "drag_coefficient", self.at_fluid, (len(p),))
        i, message = loops.first_bad(beta), None
        if i >= 0:
            message = (f"The drag law gave {beta[i]:g} for particle {p.id[i]} at solid fraction {solid[i]:g} and slip "
                       f"{slip[i]:g} m/s (step {p.step}, rank {self.comm.rank}); it must be finite and not negative. Check "
                       f"the "
                       "law's range or use larger cells.")
        raise_everywhere(self.comm, FloatingPointError, message)
        return beta

    def _by_law(self, solid, slip, dt):
        """Drag coefficient of each particle by the law of :class:`Drag`, at its slip or over the step."""
        p, sauter = self.particles, None
        if self.drag.polydisperse:
            sizes = np.hstack([self.volume, self.volume / p.primary_diameter[:, None]])
            sums = self._gather(self._on_cells(self._to_cells(sizes)))
            sauter = sums[:, 0] / sums[:, 1]

        def at(slip):
            return self.drag.coefficient(solid, slip, diameter, self.density, self.viscosity, sauter)
        diameter = p.primary_diameter
        if not self.drag.relaxing:
            return at(slip)
        beta, rate = over_step(at, slip, p.density, dt * (1 - p.late) if len(p.late) else dt)
        self.of_way = np.where(p.held, 1.0, rate * p.density / beta)
        return np.where(p.held, at(slip), beta)

    def _accelerations(self):
        """Densities (particles, 1), infinite if held, and accelerations (particles, d): by gravity, the last mean contact
        force,
        and the other forces of the fluid as of the last step."""
        p, n = self.particles, len(self.particles)
        inertia, acceleration = self._work.empty("inertia", n, 1), self._work.empty("acceleration", n, self.dimension)
        loops.accelerations(p.held, self.volume, p.density, p.gravity, self._steady, p.mean_contact_force,
                            self.explicit_reaction,
                            self._none if self.added is not None else p.properties.get("_pressure_gradient", self._none),
                            inertia, acceleration)
        return inertia, acceleration

    # -- fluid to particles --------------------------------------------------------------------------------------------

    def to_particles(self, dt):
        """Give the particles the impulse of the fluid over the step just made, as a force over the next ``dt`` [s], and the
        change of their spin at once.

        Note:
            Collective.
        """
        if positive_number("time step", dt) != self._dt:
            raise ValueError(f"The time step of to_particles is {dt}, that of to_fluid before was {self._dt}; call "
                             "to_fluid(dt) first, with the same step.")
        tick = self._begin()
        p, d, n = self.particles, self.dimension, self.particles.cells.owned
        a, b = self.fields[1].x.array[:n], self.fields[2].x.array.reshape(-1, d)[:n]
        u = self.step_mean()
        slope = self.gradient_mean() if self.pressure_force is not None else np.zeros((n, 0))
        rows = self._work.empty("answer", n, d + slope.shape[1])
        received, changed = loops.answer(p.cells.volume[:n], self.fields[0].x.array[:n], a, b, self.cell_velocity, u, slope,
                                         rows)
        changed &= self.ahead is None
        back = self._back(rows)
        self._kept = (u.copy(), back[:, :d]) if not self.spill.moves else None
        at_particles = self._gather(back, "velocity_and_slope")
        if self.pressure_force is not None:
            if self.added is not None:
                received -= (p.cells.volume[:n] * self.fields[3].x.array[:n]) @ slope
        if self.spin is not None:
            p.angular_velocity += self.turn
        forces = self._forces if self.added is None else self._forces_with_added_mass
        given, mass = forces(at_particles[:, :d], at_particles[:, d:])
        self._momentum_ledger(given, received, mass, changed)
        self._end("drag", tick)

    def _forces(self, fluid_velocity, slope):
        """Set the particles' forces; returns the sum of those by fields of the fluid (d,), and of the masses."""
        p, drag, gradient, reaction = self.particles, self._none, self._none, self.explicit_reaction
        if self.drags:
            drag = self.scheme.force(fluid_velocity)
            if self.own is not None:
                self.own.update(p, drag)
        p.relaxation_rate[:] = self.scheme.relaxation_rate * self.of_way if self.drags else 0.0
        if self.pressure_force is not None:
            gradient = p.properties.setdefault("_pressure_gradient", np.empty((len(p), self.dimension)))
        return loops.total_force(self.volume, p.density, self._steady, drag, reaction, slope, gradient, p.force)

    def _forces_with_added_mass(self, fluid_velocity, slope):
        """The same with added mass; the fluid has received what contacts did to it in the last step, too."""
        p, reaction, d = self.particles, self.explicit_reaction, self.dimension
        given = self.added.force(p, fluid_velocity, slope)
        if self.own is not None:
            self.own.update(p, given + self.volume * slope if slope.shape[1] else given)
        given = given - self.late
        p.relaxation_rate[:] = self.added.relaxation_rate
        p.force[p.held, :d] += self.volume[p.held] * self._steady
        if len(reaction):
            p.force[p.held, :d] += reaction[p.held]
        return given.sum(0) + reaction.sum(0), p.inertia.sum()

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

    def _old_velocity(self, velocity):
        """The cell velocity made ready for particles; what the last step smoothed serves again if nothing was spilled."""
        if self._kept is None or self.spill.moves:
            return self._back(velocity)
        same = np.array_equal(self._kept[0], velocity) and len(self._kept[1]) == len(self.particles.cells.volume)
        if self.comm.allreduce(int(same)) < self.comm.size:
            return self._back(velocity)
        return np.ascontiguousarray(self._kept[1])

    def _solid_ledger(self, volume):
        """Solid volume on the cells against ``volume`` of this rank's particles, and the fullest cell."""
        cells, n = self.particles.cells, self.particles.cells.owned
        on_cells, of_particles = sums_of(self.comm, self.solid[:n, 0] @ cells.volume[:n], volume)
        self.solid_volume_error = abs(on_cells - of_particles) / max(of_particles, 1e-300)
        self.max_solid_fraction = float(largest_of(self.comm, self.solid[:n, 0].max(initial=0.0))[0])
