"""The volume-averaged Navier-Stokes equations, model A, by a cell-node scheme on simplices."""
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem
from numpy.typing import ArrayLike

from fe_el.checks import (
    components,
    function_or_class_of,
    not_negative_number,
    numbers,
    positive_number,
    require_mesh,
    require_tags,
)
from fe_el.dolfinx_api import vector_space
from fe_el.fluid import cell_kernels
from fe_el.fluid.boundary_values import check_fields, velocity_at
from fe_el.fluid.continuity import Ledger
from fe_el.fluid.drag_in_transport import DragInTransport
from fe_el.fluid.pressure_equation import PressureEquation
from fe_el.fluid.projection import Projection
from fe_el.fluid.records import Masses, Memory, SolidsAnswer, Step
from fe_el.fluid.saved_fluid import SavedFluid
from fe_el.fluid.state import FluidState, StepState
from fe_el.fluid.transport import Transport
from fe_el.nodes.linear_solver import LinearSolver
from fe_el.nodes.nodal_matrix import NodalMatrix
from fe_el.parallel.exchange import Halo

if TYPE_CHECKING:
    from dolfinx.mesh import Mesh

    from fe_el.fluid.stabilisation import Streamline, Upwind

START_STEPS = 2  # implicit Euler steps that damp a start which does not fit its boundary conditions


class VolumeAveragedNavierStokes(Transport, Projection, Ledger, SavedFluid):
    """Flow of a fluid through the void fraction phi left by particles (model A).

        d(rho phi)/dt + div(rho phi u) = 0
        d(rho phi u)/dt + div(rho phi u u) = -phi grad p + phi div tau - A u + B + rho phi g

    One velocity vector per cell carries the momentum; a nodal P1 velocity transports it; the pressure is P1. Drag A and
    pressure are solved together, so any drag, and any jump of it between cells, is stable.

    Args:
        mesh: dolfinx mesh of triangles or tetrahedra.
        facet_tags: boundary groups (dolfinx MeshTags of facets); absent: every boundary is a slip wall.
        density (float): rho [kg/m^3].
        viscosity (float): dynamic viscosity mu [Pa s].
        gravity: acceleration [m/s^2]; absent: none.
        tolerance (float): relative residual of the linear solvers.
        mean_pressure_gradient: constant part of -grad p beside the solved pressure [Pa/m], on the fluid's share phi of the
            volume: what carries the weight in a periodic box (give particles the same by ``PressureGradient(mean=...)``).
        turbulence: eddy viscosity, for instance :class:`Smagorinsky` (see :mod:`fe_el.fluid.turbulence`); absent: laminar.
        stabilisation: :class:`Streamline` or :class:`Upwind` (see :mod:`fe_el.fluid.stabilisation`); absent: none.
        time_order (int): 2, or 1: implicit Euler, which damps what the step does not resolve.
        stress_of_mixture (bool): the fluid carries div tau, not phi div tau; for particles with ``ViscousStress``.

    Attributes:
        velocity: DG0 vector Function, interstitial velocity u [m/s].
        pressure: P1 Function, of the middle of the step [Pa].
        body_force: force per fluid volume [N/m^3]: d numbers, (cells, d), or a function (time, points (cells, 3)) of which
            the cell means are taken in the middle of the step; ``None``: none.
        mass_source: volume of fluid per volume and time [1/s], that comes in with the local velocity only if ``body_force``
            says so; a number, (cells,), or a function; ``None``: none.
        eddy_viscosity: (cells,) of the closure in the last step [m^2/s]; ``None``: none yet.

    Raises:
        ValueError: for cells that are not simplices, a density or viscosity out of range, or an unknown boundary group.

    Note:
        Collective.
    """

    takes_pressure_share = True  #: ``advance`` takes a fourth field; see :class:`fe_el.PressureGradient`

    def __init__(self, mesh: "Mesh", facet_tags: Any = None, density: float = 1.2, viscosity: float = 1.8e-5,
                 gravity: ArrayLike | None = None, tolerance: float = 1e-8, mean_pressure_gradient: ArrayLike | None = None,
                 stress_of_mixture: bool = False, turbulence: Callable[[Any, np.ndarray], np.ndarray] | None = None,
                 time_order: int = 2, stabilisation: "Streamline | Upwind | None" = None) -> None:
        require_mesh(mesh)
        super().__init__(mesh)
        if facet_tags is not None:
            require_tags("facet tags of the fluid", facet_tags, mesh)
        self.facet_tags, self.density = facet_tags, positive_number("fluid density", density)
        self.viscosity = not_negative_number("fluid viscosity", viscosity)
        self.tolerance = positive_number("tolerance of the fluid's solvers", tolerance)
        n, d = self.num_cells, self.dimension
        self.gravity = np.zeros(d) if gravity is None else components("gravity", gravity, d)
        self.velocity = fem.Function(vector_space(mesh, "DG", 0), name="velocity")
        self.pressure = fem.Function(self.space, name="pressure")
        self.cell_velocity, self.nodal_pressure = self.velocity.x.array.reshape(-1, d), self.pressure.x.array
        self.cell_halo = Halo.of_index_map(mesh.comm, self.velocity.function_space.dofmap.index_map)
        self.state, self.last_step, self.no_share = FluidState(n, self.nodes, d), None, np.zeros(n)
        self.time, self.step, self.seconds = 0.0, 0, {"fluid": 0.0}
        self.inlets, self.outlets, self.no_slip, self.slip, self._facets, self._conditions = [], [], [], [], {}, {}
        mean = np.zeros(d)
        if mean_pressure_gradient is not None:
            mean = components("mean pressure gradient", mean_pressure_gradient, d)
        if not isinstance(time_order, int) or time_order not in (1, 2):
            raise ValueError(f"The time order (time_order) is {time_order!r}; it must be 1 or 2.")
        if turbulence is not None:
            function_or_class_of("turbulence", turbulence, "an object such as Smagorinsky(), or leave it out")
        if stabilisation is not None and (isinstance(stabilisation, type) or not hasattr(stabilisation, "upwind")):
            raise ValueError(f"The stabilisation is {stabilisation!r}; pass Streamline() or Upwind(), or leave it out.")
        self.turbulence, self.time_order, self.stabilisation = turbulence, time_order, stabilisation
        self.upwind = stabilisation is not None and stabilisation.upwind
        self.mean_pressure_gradient, self.stress_of_mixture = mean.copy(), bool(stress_of_mixture)
        self._solvers, self._closed_flux, self.ready, self.as_new = (), None, False, False
        self._fields: tuple[Any, tuple[np.ndarray, ...]] = (None, ())  # that were given last, and their arrays
        self._single_phase: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self.body_force = self.mass_source = self.eddy_viscosity = None

    def set_initial_velocity(self, value: ArrayLike | Callable[[float, np.ndarray], ArrayLike]) -> None:
        """Interstitial velocity at the start: d numbers, or a function (time, position) as for inlets."""
        v = velocity_at(value, self.time, self.corner.mean(1), self.dimension)
        self.velocity.x.array.reshape(-1, self.dimension)[:self.num_cells] = v
        self.velocity.x.scatter_forward()
        self.state.nodal_velocity = None

    def _setup(self):
        """Matrices, solvers and fixed nodes, once the boundary conditions are known."""
        if self._solvers:
            for solver in (*self._solvers, *self.drag_in_transport.coupled_pressure.solvers,
                           *([self._closed_flux.solver] if self._closed_flux else ())):
                solver.free()
        self.ready, self.as_new = True, False
        self.transport_matrix = NodalMatrix(self.space, self.dofs)
        self.transport_solver = LinearSolver(self.transport_matrix.matrix, "transport", "bcgs", "jacobi", self.tolerance)
        self._hold_nodes()
        self._thetas, self._steady_inflow, self._closed_flux = {}, None, None
        self.pressure_equation, self.drag_in_transport = PressureEquation(self), DragInTransport(self)
        self._solvers = self.transport_solver, self.pressure_equation.solver
        self.boundary_velocity, self._values_set = np.zeros((self.nodes, self.dimension)), False

    # -- one step ------------------------------------------------------------------------------------------------------

    def advance(self, dt: float, fields: Sequence[fem.Function] | None = None,
                pressure_share: np.ndarray | None = None) -> None:
        """Advance by ``dt`` [s].

        Args:
            fields: (void fraction, drag coefficient A, momentum source B): two DG0 Functions and a DG0 vector Function,
                for instance ``Coupling.fields``; absent: single-phase flow. A fourth, DG0, is the share of the gradient of
                the solved pressure that the fluid takes beside the void fraction: what light particles hand on to it. A
                fifth and sixth, DG0: what the solids' volume flux answers to a change of the fluid's velocity and of minus
                the pressure gradient [m^3 s/kg] within the step.
            pressure_share: part (cells,) of pressure gradient and body force that the fluid takes; absent: the void
                fraction.

        Raises:
            SolverDiverged: if a linear solver fails.
            ValueError: for a void fraction that is not positive.

        Note:
            Collective.
        """
        dt, tick = positive_number("time step", dt), time.perf_counter()
        step = self._begin(dt, fields, pressure_share)
        self._mass_flux(step)
        self.time, self.step = self.time + dt, self.step + 1
        step.second_order = self.time_order == 2 and self.step > START_STEPS and not self.upwind
        self.drag_in_transport.start(step)
        self._relax(step)
        self.set_boundary_values(None if step.single_phase else step.after)
        self._transport(step)
        self._exchange(step)
        self.state.void_fraction, self.state.rate, self.state.dt, self.last_step = step.after, step.rate, dt, step
        self.seconds["fluid"] += time.perf_counter() - tick

    def _begin(self, dt: float, fields: Sequence[fem.Function] | None, pressure_share: np.ndarray | None) -> StepState:
        """The step with what it is given, and with what follows from the void fraction."""
        n, d, work, state = self.num_cells, self.dimension, self.work, self.state
        phi, drag, source, *others = self._given(fields)
        phi0 = phi if state.void_fraction is None else state.void_fraction
        if not self.ready or self.as_new:
            self._setup()
            self.set_boundary_values(phi0 if phi0 is not phi or fields is not None else None)
        q = work.empty("start_of_cells", n, d)
        q[:] = self.cell_velocity[:n]
        rate, damping = work.other("rate", state.rate, n), work.empty("damping", n)
        masses = Masses(work.empty("mass_before", n), work.empty("mass_after", n))
        moves = cell_kernels.begin(self.density, dt, phi0, phi, drag, self.volume, rate, *masses, damping)
        return StepState(
            numbers=Step(dt, float(self.density), self.viscosity / self.density, self.upwind), single_phase=fields is None,
            before=phi0, after=phi, rate=rate, last_rate=state.rate, drag=drag, source=source,
            share=phi if pressure_share is None else self._share(pressure_share),
            handed=others[0] if others else None,
            answer=SolidsAnswer(*others[1:])
            if len(others) > 1 and self.step else None,  # the first step knows no pressure before it
            velocity=q, masses=masses, damping=damping, moves=moves,
            memory=Memory(state.gain, state.nodal_gain, state.fades, work.empty("left", n), work.empty("lag", n)))

    def _share(self, given):
        """The share of the pressure gradient, checked."""
        share = numbers("pressure share", given)
        if share.shape != (self.num_cells,) or not np.isfinite(share).all():
            raise ValueError(f"The pressure share has shape {share.shape}; give one finite number for each of the "
                             f"{self.num_cells} cells of this rank.")
        return share

    def _given(self, fields):
        """Void fraction, drag and source of this rank's cells, and what else the fields hold."""
        n, d = self.num_cells, self.dimension
        if fields is None:
            self._single_phase = self._single_phase or (np.ones(n), np.zeros(n), np.zeros((n, d)))
            return self._single_phase
        if fields is not self._fields[0]:
            check_fields(fields, n, d)
            now, drag, source, *others = (f.x.array for f in fields)
            known = fields if isinstance(fields, tuple) else None  # which is always the same: it need not be looked at again
            self._fields = known, (now[:n], drag[:n], source.reshape(-1, d)[:n], *(a[:n] for a in others))
        now, *others = self._fields[1]
        phi = self.work.other("void_fraction", self.state.void_fraction, n)
        phi[:] = now
        if n and not phi.min() > 0:
            raise ValueError(f"The void fraction of cell {int(np.argmin(phi))} on rank {self.comm.rank} is "
                             f"{phi.min():g}; it must be positive. Use larger cells or smoothing.")
        return phi, *others
