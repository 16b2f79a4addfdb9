"""The open list of forces of a coupling: what they see of the fluid, and what the fluid gets back."""
import numpy as np

from fe_el.coupling.fluid_at_particles import FluidAtParticles, given


class OpenForces:
    """Forces of the open list of :class:`Coupling`."""

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
