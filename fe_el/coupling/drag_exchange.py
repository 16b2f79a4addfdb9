"""What a coupling does with the drag of each particle: fields for the fluid, and forces for the particles."""
import warnings

import numpy as np

from fe_el.coupling import particle_loops as loops
from fe_el.coupling.fitting import step_beyond_sense, step_too_fast
from fe_el.coupling.fluid_at_particles import given
from fe_el.coupling.relaxing_slip import over_step
from fe_el.coupling.schemes import Conservative, Exchange, Explicit
from fe_el.parallel.exchange import largest_of, raise_everywhere, total_of

CROWDED = 0.3  # solid fraction of the fullest cell from which particles' answer is part of the fluid's balance


class DragExchange:
    """Drag fields and forces of :class:`Coupling`."""

    def _drag_fields(self, dt):
        """A and B from the drag of each particle over the coming step."""
        p, d = self.particles, self.dimension
        cell_velocity, n, velocity = self.cell_velocity, p.cells.owned, p.velocity[:, :d]
        back, offset = self._as_before(cell_velocity), None
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
            solid = self.own.around(p, self.mapping.concentration(volume), solid, slip)
        beta = self._coefficient(solid, slip, dt)
        if self.own is not None:
            ahead = self.own.ahead(dt, p, beta)
            mean[:, 1:] += own - ahead
            offset = -ahead if offset is None else offset - ahead
        inertia, acceleration = self._accelerations()
        at_once = type(self.scheme) is Conservative and self.added is None
        self.exchange = Exchange(dt, self.volume, inertia, velocity, acceleration, beta[:, None], mean[:, 1:], offset,
                                 self._to_cells_with_reaction if at_once else self._to_cells, lambda q: self._deposit(q)[:n],
                                 cell_velocity, self.fixed or (lambda field, filled: field), p.late)
        a, b = self.scheme.fields(self.exchange) if self.added is None else self._fields_with_added_mass(solid)
        if self.spin is not None or not at_once and (self.reacts or self.came and self.pressed):
            b = b + self._reaction(not at_once)
        if self.steps_to_check == 0:
            self._check_step(dt, beta)
        self.steps_to_check -= 1
        self._set(1, a)
        self._set(2, b)

    def _to_cells_with_reaction(self, rate_and_source):
        """Cell densities of both, with what particles get beside drag and pressure taken off the source."""
        if not len(self.explicit_reaction):
            return self._to_cells(rate_and_source)
        rows = rate_and_source.copy()
        rows[:, 1:] -= self.explicit_reaction
        return self._to_cells(rows)

    def _check_step(self, dt, beta):
        """Warn once of a step far beyond sense, or too fast for a gas that answers in one; in the first step, in the second,
        which knows whether it answers, and then every hundredth."""
        p, n = self.particles, self.particles.cells.owned
        in_cells = self._to_cells(self.volume * beta[:, None])[:, 0] / (self.density * (1 - self.solid[:n, 0]))
        rates = largest_of(self.comm, in_cells.max(initial=0.0), np.where(p.held, 0.0, beta / p.density).max(initial=0.0))
        message = step_beyond_sense(dt, *rates, type(self.scheme) is Explicit)
        if not message and self.answers and self.added is None and self.step_mean is self.velocity_mean:
            among = np.flatnonzero(self.solid[:n, 0] > 0)
            courant = loops.largest_courant(self.cell_velocity[among], self._cell_size[among], dt)
            message = step_too_fast(dt, largest_of(self.comm, courant)[0])
        self.steps_to_check = -1 if message else 1 if self.answers is None else 100
        if message and self.comm.rank == 0:
            warnings.warn(message, RuntimeWarning, stacklevel=4)

    def _fields_with_added_mass(self, solid):
        """The same, and the share of the pressure gradient that particles hand on to the fluid."""
        rows, self.late = self.added.fields(self.exchange, self.particles, solid, self.density)
        if self.came and self.pressure_force is not None:  # the constant part of what is handed on while they are not there
            self.late = self.late + self.particles.late[:, None] * self.volume * self.pressure_force.mean[:self.dimension]
        d, crowded = self.dimension, self.max_solid_fraction > CROWDED
        columns = [rows[:, :2], self.late - rows[:, 2:]] + ([self.added.answer] if crowded else [])
        out = self._to_cells(np.hstack(columns))
        for which, first in ((3, 1), (4, 2 + d), (5, 3 + d)):
            self._set(which, out[:, first:first + 1] if first < out.shape[1] else self.nothing)
        return out[:, :1], out[:, 2:2 + d]

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
        loops.accelerations(p.held, self.volume, p.density, p.gravity, self._steady, p.mean_contact_force, self.acting,
                            self._none if self.added is not None else p.properties.get("_pressure_gradient", self._none),
                            inertia, acceleration)
        return inertia, acceleration

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
        sums = loops.total_force(self.volume, p.density, self._steady, drag, reaction, slope, gradient, p.force)
        if self.came and self.buoyancy is not None:
            d = self.dimension
            p.force[:, :d] += p.late[:, None] * self.volume * self.density * p.gravity[:d]
        return sums

    def _forces_with_added_mass(self, fluid_velocity, slope):
        """The same with added mass; the fluid has received what contacts did to it in the last step, too."""
        p, reaction, d = self.particles, self.explicit_reaction, self.dimension
        given = self.added.force(p, fluid_velocity, slope)
        if self.own is not None:
            there = self.volume * (1 - p.late[:, None]) if self.came else self.volume
            self.own.update(p, given + there * slope if slope.shape[1] else given)
        given = given - self.late
        p.relaxation_rate[:] = self.added.relaxation_rate
        p.force[p.held, :d] += self.volume[p.held] * self._steady
        if len(reaction):
            p.force[p.held, :d] += reaction[p.held]
        return given.sum(0) + reaction.sum(0), p.inertia.sum()

    def _as_before(self, values, first=0):
        """Cell values (the columns from ``first`` on of velocity and pressure gradient) made ready for particles; what the
        last step smoothed serves again if nothing was spilled."""
        columns = slice(first, first + values.shape[1])
        if self._kept is None or self.spill.moves or self._kept[0].shape[1] < columns.stop or self._kept[2] is not self.near:
            return self._back(values)
        same = np.array_equal(self._kept[0][:, columns], values) and len(self._kept[1]) == len(self.particles.cells.volume)
        if total_of(self.comm, int(same)) < self.comm.size:
            return self._back(values)
        return np.ascontiguousarray(self._kept[1][:, columns])
