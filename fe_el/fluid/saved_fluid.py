"""The fluid in checkpoints."""
import numpy as np

from fe_el.fluid.cell_node_fluid import CellNodeFluid
from fe_el.fluid.state import FluidState


class SavedFluid(CellNodeFluid):
    """What :class:`VolumeAveragedNavierStokes` keeps of itself and takes back."""

    def saved(self) -> dict[str, tuple]:
        """Fields of the fluid that the next step starts from."""
        n, own, d = self.num_cells, self.owned_nodes, self.dimension
        cells, nodes, numbers = self.state.saved(own)
        if self.eddy_viscosity is not None:
            cells["eddy_viscosity"] = self.eddy_viscosity
        cells["velocity"], nodes["pressure"] = self.velocity.x.array.reshape(-1, d)[:n], self.pressure.x.array[:own]
        return {"cells": (self.corner.mean(1), cells), "nodes": (self.node_position[:own], nodes),
                "same": (None, {"time": self.time, "step": self.step, **numbers})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take the fields back."""
        n, own, d = self.num_cells, self.owned_nodes, self.dimension
        cells, owned, same = state["cells"], state["nodes"], state["same"]
        if "_last_flux" in cells:  # a file of an older version
            cells["last_flux"] = cells.pop("_last_flux")
        self.velocity.x.array.reshape(-1, d)[:n] = cells.pop("velocity")
        self.eddy_viscosity = cells.pop("eddy_viscosity", None)
        self.pressure.x.array[:own] = owned.pop("pressure")
        self.velocity.x.scatter_forward()
        self.pressure.x.scatter_forward()
        nodes = {}
        for name, value in owned.items():
            nodes[name] = np.zeros((self.nodes, *value.shape[1:]))
            nodes[name][:own] = value
            self.node_halo.forward(nodes[name])
        self.state, self.last_step = FluidState(n, self.nodes, d), None
        self.state.restore(cells, nodes, same)
        self.time, self.step = float(same["time"]), int(same["step"])
        self.as_new = True

    def anew(self) -> None:
        """Let the next step make matrices and solvers anew, as a run that goes on from a checkpoint does."""
        self.as_new = True
