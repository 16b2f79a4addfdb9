"""Several steps of the fluid for one exchange with the particles."""
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from fe_el.checks import of_kind, positive_number, whole_number
from fe_el.dolfinx_api import scalar_space
from fe_el.fluid.boundary_values import check_fields
from fe_el.fluid.cells_and_nodes import CellsAndNodes

if TYPE_CHECKING:
    from fe_el.fluid.volume_averaged_navier_stokes import VolumeAveragedNavierStokes

COUNTS = ("steps_last", "steps_largest", "steps_total", "advances")


class SubCycled:
    """Makes each step of a fluid in several, with drag coefficient and source held and the void fraction changing linearly.

    For steps whose Courant number is large: particles move and exchange once, the fluid follows in smaller steps. What
    particles receive is the mean over these steps, and the fluid takes the share of the pressure gradient that belongs to
    the void fraction of the end throughout, so momentum of fluid and particles stays exact.

        air = fe_el.VolumeAveragedNavierStokes(...)
        steps = fe_el.SubCycled(air)
        coupling = fe_el.Coupling.of(steps, beads, forces)
        steps.advance(dt, coupling.fields)

    Args:
        fluid (VolumeAveragedNavierStokes): the fluid.
        steps (int): steps of the fluid in one; absent: chosen for each, by
        courant (float): so many that the Courant number of none is above this by the velocity at the start, the same on all
            ranks, at most ``most``; absent: 1.
        most (int): see ``courant``.

    Attributes:
        mean_velocity, mean_pressure: Functions, means over the steps of the last :meth:`advance`.
        steps_last (int): steps of the last :meth:`advance`; steps_largest: most of any so far.
        steps_total, advances (int): all steps so far, and calls of :meth:`advance`.

    Raises:
        ValueError: for numbers out of range.

    Note:
        Collective.
    """

    def __init__(self, fluid: "VolumeAveragedNavierStokes", steps: int | None = None, courant: float | None = None,
                 most: int = 64) -> None:
        of_kind("fluid", fluid, CellsAndNodes)
        if steps is not None and courant is not None:
            raise ValueError(f"Give a sub-cycled fluid steps= or courant=, not both: steps={steps!r}, courant={courant!r}.")
        if steps is not None:
            steps = whole_number("number of steps in one (steps)", steps, 1)
        self.fluid, self.steps = fluid, steps
        self.courant = positive_number("largest Courant number (courant)", 1.0 if courant is None else courant)
        self.steps_last = self.steps_largest = self.steps_total = self.advances = 0
        self.most = whole_number("largest number of steps in one (most)", most, 1)
        self._void_fraction = fem.Function(scalar_space(fluid.mesh, "DG", 0))
        self.mean_velocity = fem.Function(fluid.velocity.function_space, name="mean_velocity")
        self.mean_pressure = fem.Function(fluid.space, name="mean_pressure")

    def advance(self, dt: float, fields: Sequence[fem.Function]) -> None:
        """Advance by ``dt`` [s]; ``fields`` and errors are those of the fluid's own ``advance``.

        Note:
            Collective.
        """
        dt, air = positive_number("time step", dt), self.fluid
        n, phi, count = air.num_cells, self._void_fraction, self.steps or self._number(dt)
        check_fields(fields, n, air.dimension)
        new = fields[0].x.array[:n].copy()
        old = new if air.void_fraction is None else air.void_fraction.copy()  # the fluid uses its arrays again
        velocity, pressure = np.zeros_like(air.velocity.x.array), np.zeros_like(air.pressure.x.array)
        for k in range(1, count + 1):
            phi.x.array[:n] = old + k / count * (new - old)
            air.advance(dt / count, (phi, *fields[1:]), new)
            velocity += air.velocity.x.array
            pressure += air.pressure.x.array
        self.mean_velocity.x.array[:], self.mean_pressure.x.array[:] = velocity / count, pressure / count
        self.steps_last, self.steps_largest = count, max(count, self.steps_largest)
        self.steps_total, self.advances = self.steps_total + count, self.advances + 1

    def _number(self, dt):
        """Steps for one of ``dt`` [s] by the Courant number, the same on all ranks."""
        ratio = self.fluid.courant(dt) / self.courant
        return min(max(math.ceil(ratio), 1), self.most) if math.isfinite(ratio) else 1  # the fluid says what is wrong

    def saved(self) -> dict[str, tuple]:
        """The means over the last step and the counts, for a checkpoint."""
        air, d = self.fluid, self.fluid.dimension
        velocity, pressure = self.mean_velocity.x.array.reshape(-1, d), self.mean_pressure.x.array
        return {"cells": (air.corner.mean(1), {"velocity": velocity[:air.num_cells]}),
                "nodes": (air.node_position[:air.owned_nodes], {"pressure": pressure[:air.owned_nodes]}),
                "same": (None, {name: getattr(self, name) for name in COUNTS})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take them back."""
        air, d = self.fluid, self.fluid.dimension
        self.mean_velocity.x.array.reshape(-1, d)[:air.num_cells] = state["cells"]["velocity"]
        self.mean_pressure.x.array[:air.owned_nodes] = state["nodes"]["pressure"]
        for function in (self.mean_velocity, self.mean_pressure):
            function.x.scatter_forward()
        for name in COUNTS:
            setattr(self, name, int(state["same"].get(name, 0)))  # files of older versions have the first alone
