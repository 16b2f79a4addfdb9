"""The state of particles, for checkpoints."""
import numpy as np

from fe_el.mesh.places import nearest
from fe_el.particles.migration import Migration


class SavedParticles(Migration):
    """What :class:`Particles` keep of themselves and take back."""

    def saved(self) -> dict[str, tuple]:
        """All arrays of the particles, and the counters."""
        own, user = self.arrays()
        rows = {**own, **{"property:" + k: a for k, a in user.items()}, "centre": self.cells.corner[self.cell].mean(1)}
        return {"particles": (None, rows), "same": (None, {"next_id": self.next_id, "step": self.step, "left": self.left,
                                                           "left_mass": self.left_mass, "halo_width": self.halo_width})}

    def restore(self, state: dict[str, dict]) -> None:
        """Each rank takes the particles whose cells it owns."""
        rows, same = state["particles"], state["same"]
        self.reach_halo(max(3.0 * rows["diameter"].max(initial=0.0), float(same["halo_width"])))
        n = self.cells.owned
        cell, found = nearest(self.cells.corner[:n].mean(1), rows["centre"], self.period)
        total = self.comm.allreduce(int(found.sum()))
        if total != len(found):
            raise ValueError(f"The checkpoint holds {len(found)} particles, of which {total} are in cells of this mesh; "
                             "load it into the mesh that it was made with.")
        mine = np.flatnonzero(found)  # in the order in which they were: sums over them are then the same
        own, _ = self.arrays()
        if "number" not in rows:  # a file of an older version
            rows["number"] = rows["coarse_graining"] ** 3
        for name, a in own.items():
            values = rows[name][mine] if name in rows else np.zeros((len(mine), *a.shape[1:]))  # a file of an older version
            setattr(self, name, np.ascontiguousarray(values.astype(a.dtype)))
        self.cell = cell[mine].astype(np.int32)
        self.properties = {name[9:]: a[mine] for name, a in rows.items() if name.startswith("property:")}
        self.next_id, self.step, self.left = (int(same[k]) for k in ("next_id", "step", "left"))
        self.left_mass, self.layout = float(same["left_mass"]), self.layout + 1
