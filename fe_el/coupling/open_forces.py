"""The open list of forces of a coupling: what they see of the fluid, and what the fluid gets back."""
import numpy as np

from fe_el.coupling.fluid_at_particles import FluidAtParticles, given


class OpenForces:
    """Forces of the open list of :class:`Coupling`."""

    def _ask(self, dt):
        """Let the forces of the open list see the fluid, and add up those that they give."""
        self.at_fluid, self.acting, self.explicit_reaction = None, self._none, self._none
        self.came = "_late" in self.particles.properties
        if self.asked is not None:
            self._ask_forces(dt)
        if self.came:
            self._only_while_there()

    def _ask_forces(self, dt):
        """What forces of the list give while they act (particles, d), as of the start of the step."""
        p, d = self.particles, self.dimension
        back = self._back(self.asked.columns(self.cell_velocity))
        means = self._gather(back, "asked")
        if self.linear is not None and self.asked.velocity:
            self.linear.gather(np.ascontiguousarray(back[:, :d]), means[:, :d])
        solid = self._gather(self.solid, "solid_of_forces") if self.asked.solid else None
        self.at_fluid = FluidAtParticles(p, dt, self.density, self.viscosity, self.volume[:, 0],
                                         self.asked.quantities(means, solid, p.velocity[:, :d]))
        if "force" in self.others:
            self.acting = self.explicit_reaction = np.zeros((len(p), d))
            for force in self.others["force"]:
                self.acting += given(force, "force", self.at_fluid, (len(p), d))
        if self.spin is not None:
            self.turn, self.torque = self.spin.over_step(self.at_fluid)

    def _only_while_there(self):
        """Means over the step of the forces on those who come in late. The fluid's part of the pressure force is that of the
        whole volume: what is too much, by the last step's gradient, is taken back from both sides alike."""
        p, late = self.particles, self.particles.late[:, None]
        if len(self.acting):
            self.explicit_reaction = (1 - late) * self.acting
        if self.pressed:
            slope = self._gather(self._as_before(self.gradient_mean(), self.dimension), "slope_of_late")
            too_much = late * self.volume * (slope - self.pressure_force.mean[:self.dimension])
            self.explicit_reaction = self.explicit_reaction + too_much if len(self.explicit_reaction) else too_much
            if "_pressure_gradient" in p.properties:
                p.properties["_pressure_gradient"][late[:, 0] > 0] = slope[late[:, 0] > 0]

    def _reaction(self, of_forces=True):
        """Momentum source (owned cells, d) by what the particles get beside drag and pressure: the opposite; without
        ``of_forces`` that of their spin alone."""
        source = np.zeros((self.particles.cells.owned, self.dimension))
        if of_forces and ("force" in self.others or self.came and self.pressed):
            source -= self._to_cells(self.explicit_reaction)
        if self.spin is not None:
            source -= self.spin.force_of(self._to_cells(self.torque))
        return source
