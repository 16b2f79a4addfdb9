"""What the stages of the fluid, its boundary conditions and its ledger share."""
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem

from fe_el.fluid.cells_and_nodes import CellsAndNodes

if TYPE_CHECKING:
    from fe_el.fluid.boundary_conditions import BoundaryFacets


class CellNodeFluid(CellsAndNodes):
    """Attributes of :class:`VolumeAveragedNavierStokes` that more than one of its parts reads; it sets them."""

    velocity: fem.Function
    pressure: fem.Function
    density: float
    viscosity: float
    facet_tags: Any
    upwind: bool
    step: int  #: steps made so far
    ready: bool  #: whether matrices and solvers fit the boundary conditions
    second_order: bool  #: of the step at hand, in time
    inlets: list[tuple]
    outlets: list[tuple]
    no_slip: list[tuple]
    slip: list[tuple]
    boundary_velocity: np.ndarray  #: (nodes, d) of the nodes that boundaries hold [m/s]
    fixed_pressure: np.ndarray  #: (nodes,) bool
    void_fraction: np.ndarray | None  #: (cells,) at the end of the last step; None: no step yet, and no particles
    rate: np.ndarray  #: (cells,) of the void fraction in the last step [1/s]
    supply: np.ndarray  #: (cells,) volume that the cells give off per volume and time [1/s]
    inflow: np.ndarray  #: (nodes,) volume per time that the inlets let in [m^3/s]
    gain: np.ndarray
    nodal_gain: np.ndarray
    fades: np.ndarray
    theta: np.ndarray
    lag: np.ndarray
    _facets: dict[int, "BoundaryFacets"]
    _conditions: dict[int, tuple]
    _values_set: bool
    _steady_inflow: np.ndarray | None
    _thetas: dict[tuple, np.ndarray]
    _single_phase: tuple[np.ndarray, np.ndarray, np.ndarray] | None
