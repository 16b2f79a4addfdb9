"""Particles that are held where they are."""
from numpy.typing import ArrayLike

from fe_el.checks import truth_values
from fe_el.parallel.exchange import total_of
from fe_el.particles.arrays import ParticleArrays


class Held(ParticleArrays):
    """Holding and releasing of :class:`Particles`."""

    def hold(self, mask: ArrayLike | None = None) -> None:
        """Hold particles where they are, all or those of a mask (particles of this rank,): ``held`` is true for them.

        Fluid and other particles meet them as bodies that nothing moves; what holds them takes up every force.

        Note:
            Collective.
        """
        self.held[slice(None) if mask is None else truth_values("mask of particles", mask, len(self))] = True
        for name in ("velocity", "angular_velocity", "mean_contact_force", "relaxation_rate"):
            getattr(self, name)[self.held] = 0.0
        self.layout += 1

    def release(self, mask: ArrayLike | None = None) -> None:
        """Let held particles move again from rest, all or those of a mask (particles of this rank,).

        Note:
            Collective.
        """
        self.held[slice(None) if mask is None else truth_values("mask of particles", mask, len(self))] = False
        self.layout += 1

    def all_held(self) -> bool:
        """Whether no particle of any rank can move. Collective."""
        return not total_of(self.comm, int(not self.held.all()))
