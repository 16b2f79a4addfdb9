"""What the stages of the fluid, its boundary conditions and its ledger share."""
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem
from numpy.typing import ArrayLike

from fe_el.fluid.cells_and_nodes import CellsAndNodes
from fe_el.fluid.state import FluidState, StepState
from fe_el.nodes.linear_solver import LinearSolver
from fe_el.nodes.nodal_matrix import NodalMatrix
from fe_el.parallel.exchange import Halo

if TYPE_CHECKING:
    from fe_el.fluid.boundary_conditions import BoundaryFacets
    from fe_el.fluid.continuity import ClosedFlux
    from fe_el.fluid.drag_in_transport import DragInTransport
    from fe_el.fluid.pressure_equation import PressureEquation
    from fe_el.fluid.walls import WallFriction


class CellNodeFluid(CellsAndNodes):
    """What more than one part of :class:`VolumeAveragedNavierStokes` reads of it: n cells, m nodes, d dimensions."""

    velocity: fem.Function
    pressure: fem.Function
    cell_velocity: np.ndarray  #: (cells, d) values of ``velocity``, those of other ranks last [m/s]
    nodal_pressure: np.ndarray  #: (m,) values of ``pressure`` [Pa]
    body_force: ArrayLike | Callable[[float, np.ndarray], ArrayLike] | None
    mass_source: ArrayLike | Callable[[float, np.ndarray], ArrayLike] | None
    eddy_viscosity: np.ndarray | None
    density: float
    viscosity: float
    gravity: np.ndarray
    mean_pressure_gradient: np.ndarray
    stress_of_mixture: bool
    time_order: int
    turbulence: Callable[[Any, np.ndarray], np.ndarray] | None
    stabilisation: Any
    upwind: bool
    facet_tags: Any

    # what it has come to
    step: int  #: steps made so far
    state: FluidState
    last_step: StepState | None  #: as its stages left it; None: none, or none since a restart

    # boundary conditions: facets, and what was set
    inlets: list[tuple]
    outlets: list[tuple]
    no_slip: list[tuple]
    slip: list[tuple]
    boundary_velocity: np.ndarray  #: (m, d) of the nodes that boundaries hold [m/s]
    fixed: np.ndarray  #: (m,) bool, nodes that boundaries hold
    held: np.ndarray  #: their numbers
    fixed_pressure: np.ndarray  #: (m,) bool, nodes of outlets
    at_wall: np.ndarray  #: (m,) bool, nodes of no-slip walls
    slip_nodes: np.ndarray  #: nodes that walls hold in some directions
    slip_normals: np.ndarray  #: (slip nodes, d)
    wall_friction: "WallFriction | None"
    _facets: dict[int, "BoundaryFacets"]
    _conditions: dict[int, tuple]
    _values_set: bool
    _steady_inflow: np.ndarray | None

    # matrices and solvers
    ready: bool  #: whether they fit the boundary conditions
    as_new: bool  #: whether the next step makes them anew
    cell_halo: Halo
    transport_matrix: NodalMatrix
    transport_solver: LinearSolver
    pressure_equation: "PressureEquation"
    drag_in_transport: "DragInTransport"
    no_share: np.ndarray  #: (n,) zeros
    _closed_flux: "ClosedFlux | None"
    _thetas: dict[tuple, np.ndarray]

    @property
    def void_fraction(self) -> np.ndarray | None:
        """(cells,) at the end of the last step; ``None`` before the first: set it if the first step changes it."""
        return self.state.void_fraction

    @void_fraction.setter
    def void_fraction(self, value: np.ndarray | None) -> None:
        self.state.void_fraction = value

    @property
    def nodal_velocity(self) -> np.ndarray | None:
        """(nodes, d) at the end of the last step [m/s]; ``None``: not made yet of the cells' velocities."""
        return self.state.nodal_velocity
