"""Two-way coupling: particles to three cell fields, and the impulse the fluid really gave back to them."""
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem

from fe_el.checks import function_or_class_of, positive_number
from fe_el.coupling import mapping as _mapping
from fe_el.coupling import particle_loops as loops
from fe_el.coupling.added_mass import AddedMass
from fe_el.coupling.drag_exchange import DragExchange
from fe_el.coupling.fields import CellMean, PressureGradientMean
from fe_el.coupling.fitting import check_functions, check_list, fitting
from fe_el.coupling.fluid_at_particles import METHODS, AskedOfFluid, check_force
from fe_el.coupling.forces import Buoyancy, Drag, PressureGradient
from fe_el.coupling.ledger import Ledger
from fe_el.coupling.lift_and_torque import Spin
from fe_el.coupling.light_particles import LightParticles
from fe_el.coupling.maps import OTHER_PARTICLES, Maps
from fe_el.coupling.near_particles import NearParticles
from fe_el.coupling.open_forces import OpenForces
from fe_el.coupling.over_filled import Spill
from fe_el.coupling.saved_coupling import SavedCoupling
from fe_el.coupling.schemes import scheme_of
from fe_el.coupling.smoothing import FixedValues
from fe_el.coupling.undisturbed import UndisturbedVelocity
from fe_el.dolfinx_api import scalar_space, vector_space
from fe_el.nodes.nodal_kernels import same
from fe_el.nodes.work_arrays import WorkArrays
from fe_el.parallel.exchange import total_of

if TYPE_CHECKING:
    from fe_el.particles.particles import Particles


def _first_of(kind, forces):
    return next((f for f in forces if isinstance(f, kind)), None)


class Coupling(Maps, DragExchange, Ledger, OpenForces, LightParticles, SavedCoupling):
    """Momentum exchange of particles with any fluid that takes a void fraction, a drag coefficient and a source.

    Particles give their volume, drag and momentum to cells through the shares of a mapping, the excess of over-filled cells
    goes to their neighbours, and a self-adjoint smoothing spreads the result; what cells give back to particles passes the
    transpose of the same map. So with the ``conservative`` scheme what particles gain the fluid loses, to round-off.

    Args:
        particles (Particles): the particles.
        velocity: the fluid's interstitial velocity, a vector Function or UFL expression [m/s]. Of a fluid that particles do
            not change, set by the script: that of the middle of the step.
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
            absent: of the middle, but where a fluid answers: of the start in a liquid, whose answer to what particles
            displace would be fed back by places ahead, and earlier than the middle in one step of a Courant number above 1,
            from 4 on of the start.
        mean_velocity: mean of the velocity that drag acted on in the step, for a fluid that makes several of its own (as
            :class:`SubCycled`, with its mean pressure for ``pressure``); absent: ``velocity``.

    Attributes:
        fields: (void fraction DG0, drag coefficient A DG0 [kg/(m^3 s)], momentum source B DG0 vector [N/m^3]); with added
            mass or the pressure of the end of the step also the share of the pressure gradient (DG0) that particles hand on,
            and what the flux of crowded solids answers to a change of the fluid's velocity and of minus the pressure
            gradient.
        over_filled (int): cells that were over-filled in the last step, over all ranks.
        solid_volume_error, momentum_imbalance (float): ledger of the last step, relative to the solid volume and to the
            particles' weight, that of added mass included (without gravity: to the force).
        max_solid_fraction (float): in the last step.

    Raises:
        ValueError: for an unknown force, scheme or mapping, or a number out of range.

    Note:
        Collective.
    """

    fields: tuple[fem.Function, ...]
    checked: int  #: number of particles that came so far, when they were last checked
    gradient_mean: PressureGradientMean | None
    _dt: float | None
    _kept: tuple[np.ndarray, np.ndarray, NearParticles | None] | None
    _mapped: tuple | None
    layout: int | None

    def __init__(self, particles: "Particles", velocity: Any, pressure: Any, fluid_density: float, fluid_viscosity: float,
                 forces: Sequence[Any], scheme: str = "conservative", mapping: str | Any = "overlap_volume",
                 smoothing: Callable[[np.ndarray], np.ndarray] | None = None, fluid_velocity: str = "cell",
                 largest_solid_fraction: float = 0.74, positions: str | None = None, mean_velocity: Any = None) -> None:
        check_list(particles, forces)
        check_functions(particles.mesh, velocity, pressure, mean_velocity)
        fluid_density = positive_number("fluid density", fluid_density)
        fluid_viscosity = positive_number("fluid viscosity", fluid_viscosity)
        if not 0 < positive_number("largest_solid_fraction", largest_solid_fraction) < 1:
            raise ValueError(f"largest_solid_fraction is {largest_solid_fraction}; it must be between 0 and 1.")
        if fluid_velocity not in ("cell", "linear"):
            raise ValueError(f"fluid_velocity is {fluid_velocity!r}; use 'cell' or 'linear'.")
        if positions not in (None, "start", "middle"):
            raise ValueError(f"positions is {positions!r}; use 'start' or 'middle', or leave it out.")
        built_in = Drag, PressureGradient, Buoyancy, AddedMass, UndisturbedVelocity
        twice = [kind.__name__ for kind in built_in if sum(isinstance(f, kind) for f in forces) > 1]
        if twice:
            raise ValueError(f"The forces hold {twice[0]} more than once; give each kind of force once.")
        others = [f for f in forces if not isinstance(f, built_in)]
        for force in others:
            check_force(force)
        if smoothing is not None:
            function_or_class_of("smoothing", smoothing, "for instance HelmholtzSmoothing(mesh, length), or leave it out")
        self.particles, self.comm, self.mesh = particles, particles.comm, particles.mesh
        mesh = self.mesh
        self.density, self.viscosity, self.largest = fluid_density, fluid_viscosity, largest_solid_fraction
        self.dimension, self.answers = mesh.topology.dim, None  # whether the fluid changed in the last step
        self.ahead = {"start": 0.0, "middle": 0.5, None: None if mean_velocity is None else 0.5}[positions]
        d = self.dimension
        self.drag, self.pressure_force, self.buoyancy, law, undisturbed = (_first_of(kind, forces) for kind in built_in)
        self.others = {method: [f for f in others if hasattr(f, method)] for method in METHODS}
        self.others = {method: found for method, found in self.others.items() if found}
        self.added = self._added_mass(law, scheme, mean_velocity)
        self.pressed = self.pressure_force is not None and self.added is None  # by the gradient of the end of the step
        if self.drag is not None and self.drag.relaxing and (scheme != "conservative" or self.added is not None):
            raise ValueError("Drag(relaxing=True) needs scheme='conservative', no added mass, and the pressure of the step "
                             "before: PressureGradient(at_end=False).")
        self.drags, self.reacts = self.drag is not None or self.added is not None or "drag_coefficient" in self.others, bool(
            {"force", "spin"} & set(self.others))
        self.mapping, self.smoothing, self.scheme = _mapping.mapping_of(mapping), smoothing, scheme_of(scheme)
        self.own = None if undisturbed is None else self._own_velocity()
        self.linear = _mapping.LinearInterpolation() if fluid_velocity == "linear" else None
        scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
        self.fields = (fem.Function(scalar, name="void_fraction"), fem.Function(scalar, name="drag_coefficient"),
                       fem.Function(vector, name="momentum_source"))
        if self.added is not None:
            self.fields += tuple(fem.Function(scalar, name=name) for name in (
                "pressure_share", "answer_to_velocity", "answer_to_gradient"))
            self.nothing = np.zeros((particles.cells.owned, 1))
        self.values = [field.x.array for field in self.fields]
        self.values[0].fill(1.0)
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
        self.near = self._kept = self._mapped = self.layout = None
        self._work, self._none = WorkArrays(), np.zeros((0, d))
        self.steps_to_check = 0  # until the step is checked again; less: never
        self.over_filled = self.over_filled_total = 0
        self.solid_volume_error = self.momentum_imbalance = self.max_solid_fraction = 0.0

    @classmethod
    def of(cls, fluid: Any, particles: "Particles", forces: Sequence[Any], **kwargs: Any) -> "Coupling":
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
        pressure, one_step = flow.pressure if flow is fluid else fluid.mean_pressure, kwargs.get("mean_velocity") is None
        plain = one_step and kwargs.get("scheme", "conservative") == "conservative"
        check_list(particles, forces)
        forces = fitting(flow, particles, forces, plain and getattr(flow, "takes_pressure_share", False))
        return cls(particles, flow.velocity, pressure, flow.density, flow.viscosity, forces, **kwargs)

    # -- particles to fluid --------------------------------------------------------------------------------------------

    def to_fluid(self, dt: float) -> None:
        """Map the particles: void fraction, drag coefficient and momentum source for a step of ``dt`` [s].

        Note:
            Collective.
        """
        self._dt = positive_number("time step", dt)
        p, tick = self.particles, self._begin()
        if (self.added is None or self.added.expected) and p.next_id != self.checked and self._too_light():
            raise ValueError(f"Particles came that are too light for a pressure force without added mass in a fluid of "
                             f"{self.density:g} kg/m^3; give forces=[..., AddedMass()].")
        self._steady = np.zeros(self.dimension)  # force per volume that needs no field
        if self.pressure_force is not None:
            self._steady += self.pressure_force.mean[:self.dimension]
        if self.buoyancy is not None:
            self._steady -= self.density * p.gravity[:self.dimension]
        self.cell_velocity = self.velocity_mean().copy()
        if not self._all_as_mapped():
            self._map(dt)
        self.layout = p.layout
        self._end("mapping", tick)
        tick = self._begin()
        self._ask(dt)
        if self.drags:
            self._drag_fields(dt)
        elif self.reacts or self.pressed:
            self._set(2, self._reaction())
        self._end("drag", tick)

    def _all_as_mapped(self):
        """Whether all particles are held and where they were when they were mapped."""
        p, last = self.particles, self._mapped
        if not p.all_held():
            self._mapped = None
            return False
        now = p.position.ravel(), p.diameter
        kept = bool(last) and last[0] is p.cells and all(len(a) == len(b) and same(a, b) for a, b in zip(last[1:], now))
        self._mapped = last if kept else (p.cells, *(a.copy() for a in now))
        return total_of(self.comm, int(kept)) == self.comm.size

    def _map(self, dt):
        """Shares of the cells in every particle, and the void fraction."""
        p = self.particles
        self.position_cell, position = p.located(self._share_ahead(dt) * dt)
        self.volume = self._work.empty("volume", len(p), 1)
        volume = loops.volumes(p.diameter, self.volume)
        self.mapping.prepare(p.cells, self.position_cell, position, 0.5 * p.diameter)
        if self.linear is not None:
            self.linear.prepare(p.cells, self.position_cell, position, 0.5 * p.diameter)
        content = self._volumes(self._smooth_first(self._deposit(self.volume)[:p.cells.owned] / self._owned_volume()))
        self.spill = Spill(p.cells, p.halo, content[:, 0], self.largest)
        self.over_filled = self.spill.over_filled_everywhere
        self.over_filled_total += self.over_filled
        self.solid = self.spill(content)[:, :1] / p.cells.volume[:, None]
        self._solid_ledger(volume)
        self._set(0, 1 - self.solid)

    # -- fluid to particles --------------------------------------------------------------------------------------------

    def to_particles(self, dt: float) -> None:
        """Give the particles the impulse of the fluid over the step just made, as a force over the next ``dt`` [s], and the
        change of their spin at once.

        Note:
            Collective.
        """
        if positive_number("time step", dt) != self._dt:
            raise ValueError(f"The time step of to_particles is {dt}, that of to_fluid before was {self._dt}; call "
                             "to_fluid(dt) first, with the same step.")
        if self.layout != self.particles.layout:  # alike on all ranks
            raise RuntimeError(OTHER_PARTICLES)
        tick, p, d, n = self._begin(), self.particles, self.dimension, self.particles.cells.owned
        phi, a, b = self.values[0][:n], self.values[1][:n], self.values[2].reshape(-1, d)[:n]
        u = self.step_mean()
        slope = np.zeros((n, 0)) if self.pressure_force is None or self.gradient_mean is None else self.gradient_mean()
        rows = self._work.empty("answer", n, d + slope.shape[1])
        received, changed = loops.answer(p.cells.volume[:n], phi, a, b, self.cell_velocity, u, slope, rows)
        changed &= self.ahead is None
        back = self._back(rows)
        kept = rows.shape[1] if self.came else d
        self._kept = (rows[:, :kept].copy(), back[:, :kept], self.near) if not self.spill.moves else None
        at_particles = self._gather(back, "velocity_and_slope")
        if self.pressure_force is not None:
            if self.added is not None:
                received -= (p.cells.volume[:n] * self.values[3][:n]) @ slope
        if self.spin is not None:
            p.angular_velocity += self.turn
        forces = self._forces if self.added is None else self._forces_with_added_mass
        given, mass = forces(at_particles[:, :d], at_particles[:, d:])
        self._momentum_ledger(given, received, mass, changed)
        self._end("drag", tick)

    # -- maps ----------------------------------------------------------------------------------------------------------
