"""The fluid velocity that would be there without the particle, which is what drag laws want.

Two-way coupling gives the reaction of a particle's drag to the cells that it lies in, and their mean velocity is then no
longer that of the fluid far from it (Horwitz & Mani, J. Comput. Phys. 318 (2016) 85; Balachandar, Liu & Lakhote, J. Comput.
Phys. 376 (2019) 160; Evrard, Denner & van Wachem, J. Comput. Phys. X 8 (2020) 100078). As the exchange is linear, what the
particle feels of itself is known from the shares w of the cells: a force F in them first moves the fluid at the rate

    F / (rho V_e),    1 / V_e = sum w^2 / V_cell,

and in steady viscous flow it moves their mean velocity by

    M F = F / (6 pi mu R),    R = 0.72 V_e^(1/3) (1 - s)^0.55,

s the solid fraction of the particle alone. Evenly in a sphere of the volume V_e it would be R = 0.52 V_e^(1/3), the steady
Stokes answer, as Evrard has it, for the kernel that the shares are; the nodes blur it, and the room that the particle takes
is missing to the fluid. Helmholtz smoothing over l (twice: to the cells and back) blurs by 2 l: R is then the root of the
sum of squares. In between the velocity w relaxes at 1 / (M rho V_e); fluid that slips past carries it away, and the drag of
other particles, which share the cells, damps it:

    dw/dt = F / (rho V_e) - [1 / (M rho V_e) + 2.3 |u - w - v| / V_e^(1/3) + beta s_others / (rho phi)] w.

Drag laws get the slip u - w - v, and the solid fraction without what the particle itself makes in its cells: what it
displaces flows around them, so the slip is not that of the same flux through less room. The force also makes a pressure
gradient in its cells, whose force on the particle, 0.13 s / (1 - s) of the drag at a solid fraction s of the particle alone,
is taken off the drag coefficient. Where many share the cells all that fades with the particle's share of their solids, as
laws for beds are made for mean velocities.

Measured: R from forces that single held spheres give, at ten places each of d/h 0.1 to 1 (0.716 and 0.46 fit all of them
within 0.05 of their Stokes velocity), and from spheres that fall at Re 0.08, d/h 0.1 to 3 (0.55); 2.3 from
spheres towed and falling at Re 3 to 1000, d/h 0.1 to 1 (1.1 to 2.4); 0.13 from the pressure force on falling ones (0.08 to
0.16 at Re 0.08 to 1, more above).
"""
import math
from typing import NamedTuple

import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.direct_calls import Direct

FLUSHING = 2.3
PRESSED = 0.13
LONE, FILLED = 0.72, 0.55


class UndisturbedVelocity:
    """Takes from the fluid velocity that drag sees what the particle itself has done to it; for :class:`Coupling` in its
    list of forces, with mappings that list their shares and no smoothing but :class:`HelmholtzSmoothing`.

    It matters where particles are not small against cells, and fades in beds; see :mod:`fe_el.coupling.undisturbed`. Three
    dimensions only: in two there is no steady answer to a force. Beside walls it takes off too much.
    """


@njit(error_model="numpy")
def _leave_out(volume, concentration, solid, slip, share, around):
    """Fill a particle's share (n,) of the solids in its cells, and the solid fraction around it; slip for slip in that."""
    for i in range(len(solid)):
        concentration[i] = min(concentration[i], solid[i] / volume[i])  # over-filled cells hand on the force, too
        share[i] = min(volume[i] * concentration[i] / max(solid[i], 1e-300), 1.0)
        around[i] = solid[i] * (1 - share[i] * share[i])
        slip[i] *= ((1 - solid[i]) / (1 - around[i])) ** (1 - share[i])


class Crowd(NamedTuple):
    """Particles among those that share their cells; n of them."""

    share: np.ndarray  #: (n,) a particle's share of the solids in its cells
    solid: np.ndarray  #: (n,) solid fraction
    around: np.ndarray  #: (n,) without the particle itself
    concentration: np.ndarray  #: (n,) one over the volume that its force acts in [1/m^3]
    slip: np.ndarray  #: (n,) [m/s]


@njit(error_model="numpy")
def _predict_own(dt, medium, crowd, beta, force, own, kept, answer, ahead):
    """Fill the part (n,) of its own velocity that a particle keeps over the step, the answer (n,) to a steady force
    [m/(N s)], and the own velocity (n, d) at the end of the step if the force is that of the last one."""
    density, viscosity, length = medium
    share, solid, around, slip = crowd.share, crowd.solid, crowd.around, crowd.slip
    concentration = crowd.concentration
    for i in range(len(kept)):
        wide = 1 / concentration[i] + 8 * math.pi * length ** 3
        size = wide ** (1 / 3)
        void, filled = 1 - solid[i], share[i] * solid[i]
        radius = math.sqrt((LONE * concentration[i] ** (-1 / 3) * (1 - filled) ** FILLED) ** 2 + 4 * length * length)
        rate = 6 * math.pi * viscosity * radius / (density * wide) + FLUSHING * slip[i] / size \
            + beta[i] * solid[i] * (1 - share[i]) / (density * void)
        kept[i] = math.exp(-rate * dt)
        pressed = 1 + PRESSED * share[i] * share[i] * solid[i] / void
        answer[i] = share[i] * (1 - kept[i]) / (density * wide * rate)
        for k in range(own.shape[1]):
            ahead[i, k] = kept[i] * own[i, k] + answer[i] * force[i, k]
        beta[i] *= (void / (1 - around[i])) ** (1 - share[i]) / pressed


_predict = Direct(_predict_own)


class OwnVelocity:
    """What each particle has done to the fluid around it; it travels with the particles, in their ``properties``.

    The velocity that it takes off is that which the force of the last step would make: the fluid's own answer to the force
    of this step is implicit and larger, so the lag between both is stable at any step.
    """

    def __init__(self, density, viscosity, smoothing):
        length = 0.0 if smoothing is None else getattr(smoothing, "length", None)
        if length is None:
            raise ValueError(f"The undisturbed velocity is not known with {smoothing!r}; use HelmholtzSmoothing or none.")
        self.density, self.viscosity, self.length = density, viscosity, length

    def now(self, particles, dimension):
        """(particles, d) as of the end of the last step [m/s]."""
        p = particles
        for name in ("_own_velocity", "_own_force"):
            if name not in p.properties:
                p.properties[name] = np.zeros((len(p), dimension))
        return p.properties["_own_velocity"]

    def around(self, particles, concentration, solid, slip):
        """Solid fractions (particles,) without what the particle itself makes, all of it in a crowd; and ``slip`` in place:
        that at which the flux through both is the same."""
        p = particles
        self.crowd = Crowd(np.empty(len(p)), solid, np.empty(len(p)), concentration, slip)
        _leave_out(p.volume / p.number, concentration, solid, slip, self.crowd.share, self.crowd.around)
        return self.crowd.around

    def ahead(self, dt, particles, beta):
        """(particles, d) as it will be at the end of the step if the force is that of the last; see :func:`_predict`."""
        p, own = particles, particles.properties["_own_velocity"]
        self.kept, self.answer, ahead = np.empty(len(p)), np.empty(len(p)), np.empty_like(own)
        _predict(dt, (self.density, self.viscosity, self.length), self.crowd, beta, p.properties["_own_force"], own,
                 self.kept, self.answer, ahead)
        return ahead

    def update(self, particles, drag):
        """Go on by the force (particles, d) that the fluid gave in the step [N]."""
        p = particles
        p.properties["_own_force"] = -drag
        p.properties["_own_velocity"] = self.kept[:, None] * p.properties["_own_velocity"] - self.answer[:, None] * drag
