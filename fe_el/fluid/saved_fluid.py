"""The state of the fluid, for checkpoints."""
import numpy as np

from fe_el.fluid.cell_node_fluid import CellNodeFluid

CELLS = ("gain", "fades", "drag_gain", "last_drag", "rate", "void_fraction", "_last_flux")
NODES = ("nodal_velocity", "force", "nodal_gain", "slip_force", "past_pressures", "last_force", "last_change")


class SavedFluid(CellNodeFluid):
    """What :class:`VolumeAveragedNavierStokes` keeps of itself and takes back."""

    def memory_at_rest(self) -> dict[str, np.ndarray | None]:
        """What a step takes over from the last, before the first."""
        raise NotImplementedError

    def saved(self) -> dict[str, tuple]:
        """Fields of the fluid that the next step starts from."""
        n, own, d = self.num_cells, self.owned_nodes, self.dimension
        cells = {k: getattr(self, k) for k in CELLS if getattr(self, k) is not None}
        nodes = {k: getattr(self, k)[:own] for k in NODES if getattr(self, k) is not None}
        cells["velocity"], nodes["pressure"] = self.velocity.x.array.reshape(-1, d)[:n], self.pressure.x.array[:own]
        return {"cells": (self.corner.mean(1), cells), "nodes": (self.node_position[:own], nodes),
                "same": (None, {"time": self.time, "step": self.step, "dt": getattr(self, "dt", 0.0),
                                "to_close": self._to_close, "drag_known": self.drag_known,
                                "guess_order": self.guess_order})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take the fields back."""
        n, own, d, same = self.num_cells, self.owned_nodes, self.dimension, state["same"]
        cells, nodes = state["cells"], state["nodes"]
        self.velocity.x.array.reshape(-1, d)[:n] = cells.pop("velocity")
        self.pressure.x.array[:own] = nodes.pop("pressure")
        self.velocity.x.scatter_forward()
        self.pressure.x.scatter_forward()
        fresh = self.memory_at_rest()
        for name in CELLS:
            setattr(self, name, cells[name] if name in cells else fresh[name])
        for name in NODES:
            value = fresh[name]
            if name in nodes:
                full = np.zeros((self.nodes, *nodes[name].shape[1:]))
                full[:own] = nodes[name]
                value = self.node_halo.forward(full)
            setattr(self, name, value)
        self.drag_known = bool(same.get("drag_known", False))
        self.guess_order = int(same["guess_order"]) if "guess_order" in same else 0
        self.time, self.dt = float(same["time"]), float(same["dt"])
        self.step, self._to_close = int(same["step"]), int(same["to_close"])

    def anew(self) -> None:
        """Let the next step make matrices and solvers anew, as a run that goes on from a checkpoint does."""
        self.as_new = True
