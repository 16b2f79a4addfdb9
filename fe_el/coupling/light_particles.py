"""Added mass and undisturbed velocity, where a coupling needs or has them."""
import numpy as np

from fe_el.coupling import particle_loops as loops
from fe_el.coupling.added_mass import AddedMass, AddedMassExchange
from fe_el.coupling.undisturbed import OwnVelocity
from fe_el.parallel.exchange import largest_of, raise_everywhere

LIQUID = 0.1  # density of a fluid over that of the particles, from which its answer to displaced volume drives them


def lightest_of(particles):
    """Least density of the particles, and of those to come [kg/m^3]. Collective."""
    here = particles.density.min(initial=np.inf)
    return min(particles.default_density, -largest_of(particles.comm, -here)[0])


class LightParticles:
    """What :class:`Coupling` does for particles that are light, or not small beside their cells."""

    def _added_mass(self, law, scheme, mean_velocity):
        """The exchange with added mass: if a law is given, or where particles are so light that without one they explode;
        and the same without added mass for a pressure force of the end of the step."""
        what, message, at_end = "Added mass, which particles as light as the fluid need,", None, False
        if law is None and self._too_light():
            law = AddedMass()
        if law is None and self.pressure_force is not None and self.pressure_force.at_end:
            law, what, at_end = AddedMass(0.0), "A pressure force of the end of the step", True
        if law is None:
            return None
        if scheme != "conservative":
            message = f"{what} needs scheme='conservative', not {scheme!r}."
        elif mean_velocity is not None:
            message = f"{what} and several steps of the fluid in one (mean_velocity) do not go together."
        raise_everywhere(self.comm, ValueError, message)
        return AddedMassExchange(law, self.pressure_force is not None, at_end)

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
        self.checked, lightest = self.particles.next_id, lightest_of(self.particles)
        return self.pressure_force is not None and lightest < self.density * self.largest / (2 * (1 - self.largest))

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
        return 0.5 * float(min(max((4 - courant) / 3, 0.0), 1.0))
