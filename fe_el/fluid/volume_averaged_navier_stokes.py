"""The volume-averaged Navier-Stokes equations, model A, by a cell-node scheme on simplices."""
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem
from numpy.typing import ArrayLike

from fe_el.checks import components, function_or_class_of, not_negative_number, positive_number, require_mesh, require_tags
from fe_el.dolfinx_api import vector_space
from fe_el.fluid import cell_kernels, kernels, node_kernels
from fe_el.fluid.boundary_conditions import Boundaries
from fe_el.fluid.boundary_values import check_fields, velocity_at
from fe_el.fluid.continuity import Ledger
from fe_el.fluid.drag_in_transport import DragInTransport
from fe_el.fluid.pressure_equation import PressureEquation
from fe_el.fluid.records import Exchange, PressureSystem
from fe_el.fluid.saved_fluid import SavedFluid
from fe_el.fluid.transport import Transport
from fe_el.nodes.linear_solver import LinearSolver
from fe_el.nodes.nodal_matrix import NodalMatrix
from fe_el.parallel.exchange import Halo

if TYPE_CHECKING:
    from dolfinx.mesh import Mesh

    from fe_el.fluid.stabilisation import Streamline, Upwind

START_STEPS = 2  # implicit Euler steps that damp a start which does not fit its boundary conditions


class VolumeAveragedNavierStokes(Boundaries, Ledger, Transport, SavedFluid):
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

    body_force: ArrayLike | Callable[[float, np.ndarray], ArrayLike] | None
    mass_source: ArrayLike | Callable[[float, np.ndarray], ArrayLike] | None
    eddy_viscosity: np.ndarray | None

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
        self.cell_halo = Halo.of_index_map(mesh.comm, self.velocity.function_space.dofmap.index_map)
        self.theta, self.lag = np.empty(n), np.empty(n)
        for name, value in self.memory_at_rest().items():
            setattr(self, name, value)
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
        self.guess_order = 0  # of the extrapolation that pressure solves start from
        self.as_new = False  # whether the next step makes its matrices and solvers anew
        self._solvers, self._closed_flux = (), None
        self.ready, self.step_flux, self._to_close, self._single_phase = False, None, 0, None
        self.body_force = self.mass_source = self.eddy_viscosity = None
        self.drag_known = False  # whether drag_gain holds what drag gave in the last step

    def memory_at_rest(self) -> dict[str, np.ndarray | None]:
        """What a step takes over from the last beside velocity and pressure, by name, before the first step."""
        n, d, nodes = self.num_cells, self.dimension, self.nodes
        none = dict.fromkeys(("void_fraction", "_last_flux", "nodal_velocity", "last_force"))
        return {**none, "rate": np.zeros(n), "last_drag": np.zeros(n), "past_pressures": np.zeros((nodes, 3)),
                **{name: np.zeros((n, d)) for name in ("gain", "fades", "drag_gain")},
                **{name: np.zeros((nodes, d)) for name in ("force", "nodal_gain", "slip_force", "last_change")}}

    def set_initial_velocity(self, value: ArrayLike | Callable[[float, np.ndarray], ArrayLike]) -> None:
        """Interstitial velocity at the start: d numbers, or a function (time, position) as for inlets."""
        v = velocity_at(value, self.time, self.corner.mean(1), self.dimension)
        self.velocity.x.array.reshape(-1, self.dimension)[:self.num_cells] = v
        self.velocity.x.scatter_forward()
        self.nodal_velocity = None

    def _setup(self):
        """Matrices, solvers and fixed nodes, once the boundary conditions are known."""
        if self._solvers:
            for solver in (*self._solvers, *([self._closed_flux.solver] if self._closed_flux else ())):
                solver.free()
        self.ready, self.as_new = True, False
        self.transport_matrix = NodalMatrix(self.space, self.dofs)
        self.transport_solver = LinearSolver(self.transport_matrix.matrix, "transport", "bcgs", "jacobi", self.tolerance)
        self._hold_nodes()
        self._thetas, self._steady_inflow, self._closed_flux = {}, None, None
        self.pressure_equation, self.drag_inside = PressureEquation(self), DragInTransport(self)
        self._solvers = self.transport_solver, self.pressure_equation.solver
        self.boundary_velocity, self._values_set = np.zeros((self.nodes, self.dimension)), False

    # -- one step ------------------------------------------------------------------------------------------------------

    def advance(self, dt: float, fields: Sequence[fem.Function] | None = None,
                pressure_share: np.ndarray | None = None) -> None:
        """Advance by ``dt`` [s].

        Args:
            fields: (void fraction, drag coefficient A, momentum source B): two DG0 Functions and a DG0 vector Function,
                for instance ``Coupling.fields``; absent: single-phase flow. A fourth, DG0, is the share of the gradient of
                the solved pressure that the fluid takes beside the void fraction: what light particles hand on to it.
            pressure_share: part (cells,) of pressure gradient and body force that the fluid takes; absent: the void
                fraction.

        Raises:
            SolverDiverged: if a linear solver fails.
            ValueError: for a void fraction that is not positive.

        Note:
            Collective.
        """
        dt, tick = positive_number("time step", dt), time.perf_counter()
        n, d = self.num_cells, self.dimension
        if fields is None:
            phi, drag, source = self._single_phase = self._single_phase or (np.ones(n), np.zeros(n), np.zeros((n, d)))
        else:
            check_fields(fields, n, d)
            phi, drag = self.work.other("void_fraction", self.void_fraction, n), fields[1].x.array[:n]
            phi[:], source = fields[0].x.array[:n], fields[2].x.array.reshape(-1, d)[:n]
            if n and not phi.min() > 0:
                raise ValueError(f"The void fraction of cell {int(np.argmin(phi))} on rank {self.comm.rank} is "
                                 f"{phi.min():g}; it must be positive. Use larger cells or smoothing.")
        phi0 = phi if self.void_fraction is None else self.void_fraction
        if not self.ready or self.as_new:
            self._setup()
            self.set_boundary_values(phi0 if phi0 is not phi or fields is not None else None)
        q = self.work.empty("start_of_cells", n, d)
        q[:] = self.velocity.x.array.reshape(-1, d)[:n]
        rate0, self.rate = self.rate, self.work.other("rate", self.rate, n)
        self.cell_mass0, self.cell_mass, self.damping = (self.work.empty(k, n)
                                                         for k in ("cell_mass0", "cell_mass", "damping"))
        moves = cell_kernels.begin(self.density, dt, phi0, phi, drag, self.volume, self.rate, self.cell_mass0,
                                   self.cell_mass,
                                   self.damping)
        flux = self.step_flux = self._mass_flux(dt, phi0, q, moves)
        self.time, self.step = self.time + dt, self.step + 1
        self.second_order = self.time_order == 2 and self.step > START_STEPS and not self.upwind
        self.drag_inside.start(dt, drag, source)
        u = self._relax(dt, q)
        self.set_boundary_values(None if fields is None else phi)
        nodal, transported = self._transport_step(dt, phi0, phi, flux, q, u)
        self._supply(dt, rate0)
        share = phi if pressure_share is None else pressure_share
        if self.wall_friction is not None:
            drag, source = self.wall_friction.in_cells(self._stress_now, drag, source, q)
        handed = fields[3].x.array[:n] if fields is not None and len(fields) > 3 else None
        self._exchange(dt, phi, share, drag, source, nodal, transported, handed)
        self.drag_inside.keep(dt, phi, self.velocity.x.array.reshape(-1, d)[:n])
        self.void_fraction, self.void_fractions, self.dt = phi, (phi0, phi), dt
        self.seconds["fluid"] += time.perf_counter() - tick

    def _supply(self, dt, rate0):
        """Fluid volume that each cell gives off per volume and time, at the end of the step, where continuity is imposed.

        The rate of the void fraction there is that of the parabola through three void fractions.
        """
        self.supply = self.work.empty("supply", self.num_cells)
        cell_kernels.supply_of(self.rate, rate0, dt / (dt + self.dt) if self.second_order else 0.0, self.supply)
        if self.mass_source is not None:
            self.supply -= self.at_cells(self.mass_source, (self.num_cells,))

    def _exchange(self, dt, phi, share, drag, source, nodal, transported, handed=None):
        """Stage 3: drag and pressure together; an exact projection with the drag on the diagonal."""
        n, d, work = self.num_cells, self.dimension, self.work
        q, rhs = work.empty("exchanged", n, d), work.zeros("pressure_load", self.nodes)
        diagonal, weight = work.empty("diagonal", n), work.empty("weight", n)
        body = work.empty("constant_body", 1, d) if self.body_force is None else work.empty("body", n, d)
        body[:] = self.density * self.gravity + self.mean_pressure_gradient
        if self.body_force is not None:
            body += self.at_cells(self.body_force, (n, d), self.time - (0.5 * dt if self.second_order else 0.0))
        if handed is not None:  # of the solved pressure alone
            body, share = (share / (share + handed))[:, None] * body, share + handed
        step = self.numbers_of_step(dt)
        kernels.exchange_system(self.cells, step, phi, Exchange(share, self.supply, drag, source, body), nodal,
                                self._correction, transported, q, PressureSystem(diagonal, weight, rhs))
        self.inflow = self.inflow_at(self.time)
        rhs += self.inflow
        if not self.outlets:
            self.check_closed(dt)
        self.pressure_equation.solve(weight, rhs)
        change = work.other("force", self.force, self.nodes, d)
        change.fill(0.0)
        kernels.pressure_step(self.cells, step, phi, share, diagonal, self.pressure.x.array, transported, q, self.gain,
                              change)
        self.complete(change)
        self.velocity.x.array.reshape(-1, d)[:n] = q
        self.cell_halo.forward(self.velocity.x.array.reshape(-1, d))
        self.nodal_velocity = work.empty("nodal_velocity", self.nodes, d)
        node_kernels.after_exchange(nodal, change, self._correction, self.mass, dt, self.nodal_velocity, self.nodal_gain)
        self.impose(self.nodal_velocity)
        self.node_halo.forward(self.nodal_velocity)
        self.force = change
        if self.upwind:  # which takes nothing beforehand
            self.gain.fill(0.0)
            self.nodal_gain.fill(0.0)
