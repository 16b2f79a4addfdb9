"""Dispersion of particles by the part of the turbulence that a large-eddy simulation does not resolve."""
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from fe_el.checks import of_kind, whole_number
from fe_el.compiled.cache import njit
from fe_el.compiled.random_numbers import normal
from fe_el.coupling.forces import Drag

if TYPE_CHECKING:
    from fe_el.coupling.fluid_at_particles import FluidAtParticles

YOSHIZAWA = 0.094  # eddy viscosity over filter width and root of the unresolved energy
MEMORY = 0.5 + 0.75 * 2.1  # one over the correlation time of the velocity, in units of dissipation over energy


@njit
def _walk(cell, number, step, seed, eddy_viscosity, width, dt, velocity):
    """Carry the unresolved velocities (particles, d) over a step; a particle that has none yet draws one."""
    for i in range(len(cell)):
        root = eddy_viscosity[cell[i]] / (YOSHIZAWA * width[cell[i]])  # of the energy
        kept, new = math.exp(-dt * MEMORY * root / width[cell[i]]), True
        for k in range(velocity.shape[1]):
            new &= velocity[i, k] == 0.0
        kept = 0.0 if new else kept
        size = math.sqrt(2 / 3) * root * math.sqrt(1 - kept * kept)
        for k in range(velocity.shape[1]):
            velocity[i, k] = kept * velocity[i, k] + size * normal(seed, number[i], step, k)


class TurbulentDispersion:
    """The drag of the velocity that the mesh does not resolve: a random walk with the closure's time scale.

    Each particle sees a velocity u' beside the resolved one, with variance 2 k/3 in each direction and the correlation time
    T = k / (eps (1/2 + 3 C_0/4)), C_0 = 2.1 (Pope 1994): u' <- exp(-dt/T) u' + sqrt(1 - exp(-2 dt/T)) sqrt(2 k/3) xi. From
    the eddy viscosity of the closure and the filter width D follow k = (nu_t / (0.094 D))^2 (Yoshizawa 1985) and eps =
    k^(3/2) / D. The force V beta' u' is that of a drag that relaxes over the step, and the fluid receives the opposite. In
    turbulence that differs from place to place particles drift slowly to where there is little of it.

    The random numbers are functions of seed, number of the particle and step: the same on any number of ranks.

    Args:
        fluid (VolumeAveragedNavierStokes): with a turbulence closure.
        drag (Drag): the drag of the coupling.
        seed (int): of the walk.

    Raises:
        ValueError: for a fluid without a closure, or a drag whose law needs the mixture of sizes.
    """

    needs = ("slip", "solid_fraction")

    def __init__(self, fluid: Any, drag: Drag, seed: int = 0) -> None:
        if getattr(fluid, "turbulence", None) is None:
            raise ValueError("The fluid has no turbulence closure, so no eddy viscosity to tell what it does not resolve; "
                             "give it turbulence=, for instance Wale().")
        self.fluid, self.drag, self.seed = fluid, of_kind("drag", drag, Drag), whole_number("seed", seed, 0)
        if self.drag.polydisperse:
            raise ValueError("The drag is that of mixed sizes; give one of Drag(law), with a law of a single size.")
        self.width = fluid.volume ** (1 / fluid.dimension)

    def force(self, fluid: "FluidAtParticles") -> np.ndarray:
        """V beta' u' (particles, d) [N]."""
        p, d = fluid.particles, fluid.slip.shape[1]
        seen = p.properties.setdefault("_unresolved_velocity", np.zeros((len(p), d)))
        if self.fluid.eddy_viscosity is None:  # before the first step of the fluid
            return np.zeros((len(p), d))
        _walk(p.cell, p.id, p.step, self.seed, self.fluid.eddy_viscosity, self.width, fluid.dt, seen)
        beta = self.drag.coefficient(fluid.solid_fraction, np.linalg.norm(fluid.slip, axis=1), p.primary_diameter,
                                     fluid.density, fluid.viscosity)
        mean = np.where(p.held, beta, -p.density * np.expm1(-beta * fluid.span / p.density) / fluid.span)
        return (fluid.volume * mean)[:, None] * seen
