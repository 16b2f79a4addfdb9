"""Scalars carried by the flow: temperature, species."""
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem
from numpy.typing import ArrayLike

from fe_el.checks import number_or_function, numbers, of_kind, positive_number
from fe_el.fluid import cell_kernels, node_kernels
from fe_el.fluid.cells_and_nodes import CellsAndNodes
from fe_el.fluid.continuity import mass_balance
from fe_el.fluid.records import Held, Load, NodalSystem, Step, Void
from fe_el.fluid.transport import transport_matrix
from fe_el.nodes.linear_solver import LinearSolver
from fe_el.nodes.nodal_kernels import scatter
from fe_el.nodes.nodal_matrix import NodalMatrix
from fe_el.nodes.work_arrays import WorkArrays

if TYPE_CHECKING:
    from fe_el.fluid.volume_averaged_navier_stokes import VolumeAveragedNavierStokes


class Scalar:
    """d(rho phi c)/dt + div(rho phi u c) = div(rho phi D grad c) + S, carried by the mass flux of a fluid.

    The flux is that of the fluid's step, whose divergence is the change of the void fraction: so a constant stays constant,
    and
    the integral of rho phi c changes by sources and open boundaries only, both to the solver's tolerance. Time is of second
    order where the fluid's is. With :class:`Upwind` in the fluid it never leaves the range of its start and boundaries.
    Where fluid
    leaves, through whatever boundary, it takes its value along; where it enters it has that of :meth:`set_inflow`, without
    one
    what left there last (at the start: what is there).

    Args:
        fluid (VolumeAveragedNavierStokes): advance it first, then the scalar by the same step.
        diffusivity (float): D [m^2/s].
        initial: value at the start: a number, or a function of node positions (nodes, 3).
        name (str): of the Function.
        tolerance (float): relative residual of the solver.

    Attributes:
        value: P1 Function.
        source: S per volume and time: a number, (cells,), or a function (time, cell centres); ``None``: none. What particles
            give off is such an array: their rates mapped to cell densities.

    Raises:
        ValueError: for a diffusivity that is not positive.

    Note:
        Collective.
    """

    source: ArrayLike | Callable[[float, np.ndarray], ArrayLike] | None

    def __init__(self, fluid: "VolumeAveragedNavierStokes", diffusivity: float,
                 initial: float | Callable[[np.ndarray], ArrayLike] = 0.0, name: str = "scalar",
                 tolerance: float = 1e-10) -> None:
        self.fluid, self.diffusivity = of_kind("fluid", fluid, CellsAndNodes), positive_number("diffusivity", diffusivity)
        self.tolerance = positive_number("tolerance of a scalar's solver", tolerance)
        if not isinstance(name, str) or not name.isidentifier():
            raise ValueError(f"The name of the scalar is {name!r}; give a word of letters, digits and underscores.")
        start = numbers("initial value of a scalar", number_or_function("initial value of a scalar", initial)
                        if not callable(initial) or isinstance(initial, type) else initial(fluid.node_position))
        if start.shape not in ((), (fluid.nodes,)) or not np.isfinite(start).all():
            raise ValueError(f"The initial value of the scalar has shape {start.shape} or is not finite; give a number, "
                             "or a function of positions (nodes, 3) that returns an array (nodes,).")
        self.value = fem.Function(fluid.space, name=name)
        self.value.x.array[:] = start
        self.source, self.seconds = None, {name: 0.0}
        self.fixed: list[tuple] = []
        self.inflow: list[tuple] = []
        self.matrix = NodalMatrix(fluid.space, fluid.dofs)
        self.name = name
        self.solver: LinearSolver | None = None
        self.make_solver()
        self.name, self.work, self._held, self._open = name, WorkArrays(), None, None
        self.outside: np.ndarray | None = None  # (nodes,) values that come back in

    def make_solver(self) -> None:
        """A solver that knows nothing of earlier steps. Collective."""
        if self.solver is not None:
            self.solver.ksp.destroy()
        self.solver = LinearSolver(self.matrix.matrix, self.name, "bcgs", "jacobi", self.tolerance)

    def set_value(self, group: int | str, value: float | Callable[[float], float]) -> None:
        """Fix the value on a boundary group: a number or a function of time."""
        self.fixed.append((self.fluid.boundary(group), number_or_function("value of a scalar on a boundary", value)))
        self._held = None

    def set_inflow(self, group: int | str, value: float | Callable[[float], float]) -> None:
        """Value of what enters through a boundary group: a number or a function of time; fluid that leaves keeps its own."""
        self.inflow.append((self.fluid.boundary(group), number_or_function("value of a scalar that enters", value)))

    def _through_boundaries(self, dt, old, rhs):
        """What fluid takes along through open boundaries, on the nodes there: implicit in half where time is of second
        order.

        The mass flux through a node is what its balance leaves, so a constant stays one to round-off.
        """
        air, work, step = self.fluid, self.work, self.fluid.last_step
        if self._open is None or self._open[0] is not air.held:
            mark = np.zeros(air.nodes, bool)
            for facets, _ in (*air.inlets, *air.outlets):
                mark[facets.nodes] = True
            self._open = air.held, np.flatnonzero(mark), self.matrix.diagonal_places()
            self.whole = np.ones(air.num_cells)
        _, nodes, places = self._open
        if not (air.inlets or air.outlets):
            return
        supply = work.empty("supply_of_mass", air.num_cells)
        through, scale = work.zeros("through", air.nodes), work.zeros("scale", air.nodes)
        supply[:] = step.rate
        if air.mass_source is not None:
            supply -= air.at_cells(air.mass_source, (air.num_cells,), air.time - 0.5 * dt)
        supply *= air.density
        mass_balance(air.dofs, air.gradient, air.volume, self.whole, supply, step.flux, through, scale)
        air.complete(through)
        if self.outside is None:
            self.outside = old[:, 0].copy()
        for facets, value in self.inflow:
            self.outside[facets.nodes] = value(air.time) if callable(value) else value
        node_kernels.pass_boundaries(nodes, air.owned_nodes, places, through, old, self.outside,
                                     0.5 if step.second_order else 1.0, self.matrix.values, rhs)

    def advance(self, dt: float) -> None:
        """Advance by ``dt`` [s], the step that the fluid has just made.

        Raises:
            SolverDiverged: if the solver fails.
        """
        dt, tick = positive_number("time step", dt), time.perf_counter()
        step = self.fluid.last_step
        if step is None:
            raise ValueError("The scalar's fluid has not made a step yet; call fluid.advance(dt) first, then this with the "
                             "same step.")
        air, work = self.fluid, self.work
        self.matrix.values.fill(0.0)
        old, rhs = work.empty("old", air.nodes, 1), work.zeros("rhs", air.nodes, 1)
        old[:, 0] = self.value.x.array
        middle = air.time - 0.5 * dt if step.second_order else air.time
        share, stress = work.empty("share", air.num_cells), work.empty("stress", air.num_cells)
        cell_kernels.stress_of(step.before, step.after, step.second_order, air.density * self.diffusivity, False, share,
                               stress)
        transport_matrix(air.cells, Step(dt, air.density, self.diffusivity, air.upwind), self.matrix.entries,
                         Void(step.after, step.rate), stress, step.flux, work.zeros("none", air.nodes),
                         air.theta_of(self.diffusivity, dt, step.second_order), old, rhs)
        if self.source is not None:
            supply = np.multiply(air.at_cells(self.source, (air.num_cells,), middle), air.volume,
                                 out=work.empty("supply", air.num_cells))
            scatter(air.dofs, supply[:, None], rhs)
        air.complete(rhs)
        self._through_boundaries(dt, old, rhs)
        self._solve(dt, rhs, old)
        self.seconds[self.name] += time.perf_counter() - tick

    def _solve(self, dt, rhs, old):
        air, own, work, step = self.fluid, self.fluid.owned_nodes, self.work, self.fluid.last_step
        if self._held is None:
            mark = np.zeros(air.nodes, bool)
            for facets, _ in self.fixed:
                mark[facets.nodes] = True
            self._mark, self._held, self._unmoved = mark, np.flatnonzero(mark), np.zeros((air.nodes, 1))
        boundary, lift = work.zeros("boundary", air.nodes, 1), work.zeros("lift", air.nodes, 1)
        for facets, value in self.fixed:
            boundary[facets.nodes] = value(air.time) if callable(value) else value
        self.matrix.fix(self._mark, lift, boundary)
        air.node_halo.reverse_add(lift)
        self.matrix.assemble()
        self.matrix.release()
        self.solver.new_values()
        load, system, guess = work.empty("load", air.nodes, 1), work.empty("system", 1, own), work.empty("guess", 1, own)
        node_kernels.transport_load(step.nodal_mass_before, old, self._unmoved, Load(self._unmoved, rhs, lift), dt,
                                    Held(self._held, boundary), self.matrix.diagonal(), NodalSystem(load, system, guess))
        new = work.empty("new", air.nodes, 1)
        new[:own, 0] = self.solver.solve(system[0], guess[0])
        air.node_halo.forward(new)
        balance = work.zeros("balance", air.nodes, 1)
        self.matrix.subtract_product(new, balance)
        air.complete(balance)
        node_kernels.close_transport(step.nodal_mass, load, balance, self._unmoved, dt, self._held, new,
                                     work.empty("no_correction", air.nodes, 1))
        self.value.x.array[:] = new[:, 0]

    def total(self) -> float:
        """Integral of rho phi c over the domain."""
        air = self.fluid
        means = self.value.x.array[air.dofs].mean(1)
        phi = 1.0 if air.void_fraction is None else air.void_fraction
        return air.comm.allreduce(float((air.density * phi * air.volume) @ means))

    def saved(self) -> dict[str, tuple]:
        """The nodal values."""
        own, values = self.fluid.owned_nodes, {"value": self.value.x.array}
        if self.outside is not None:
            values["outside"] = self.outside
        return {"nodes": (self.fluid.node_position[:own], {name: a[:own] for name, a in values.items()})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take the values back."""
        air, nodes = self.fluid, state["nodes"]
        self.value.x.array[:air.owned_nodes] = nodes["value"]
        self.value.x.scatter_forward()
        self.outside = None
        if "outside" in nodes:
            self.outside = np.zeros(air.nodes)
            self.outside[:air.owned_nodes] = nodes["outside"]
            air.node_halo.forward(self.outside)

    def anew(self) -> None:
        """Make the solver anew."""
        self.make_solver()
