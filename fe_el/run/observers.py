"""What one wants to know of a run: values at points, time averages and variances of fields."""
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fe_el import checks
from fe_el.checks import finite_number, function_of_mesh, positive_number, same_mesh
from fe_el.dolfinx_api import dof_table, element_of
from fe_el.mesh.cell_mesh import barycentric_maps, owned_corners

if TYPE_CHECKING:
    from dolfinx import fem
    from dolfinx.mesh import Mesh


class Probe:
    """Values of P1 or DG0 Functions at fixed points.

    Args:
        functions: list of Functions of one mesh.
        points: (points, 2 or 3) [m].

    Attributes:
        rows: what :meth:`record` kept: (time, values of the first function at all points, ...).

    Raises:
        ValueError: for a point outside the mesh.

    Note:
        Collective.
    """

    def __init__(self, functions: "Sequence[fem.Function]", points: ArrayLike) -> None:
        if not isinstance(functions, (list, tuple)) or not functions:
            raise ValueError(f"The functions of a probe are {str(functions)[:60]!r}; give a list of at least one Function.")
        self.functions = [function_of_mesh("function of a probe", f) for f in functions]
        self.rows: list[tuple] = []
        mesh = self.functions[0].function_space.mesh
        for f in self.functions:
            same_mesh("functions of a probe", f, mesh)
        self.comm, d = mesh.comm, mesh.topology.dim
        x = checks.points("points of a probe", points)
        corner, _ = owned_corners(mesh)
        maps, _ = barycentric_maps(corner, d)
        self.number, self.cell = len(x), np.full(len(x), -1)
        self.weight = np.zeros((len(x), d + 1))
        for k, point in enumerate(x):
            b = maps[:, :, :3] @ point + maps[:, :, 3]
            best = int(np.argmax(b.min(1))) if len(b) else -1
            if best >= 0 and b[best].min() >= -1e-9:
                self.cell[k], self.weight[k] = best, b[best]
        found = self.comm.allgather(self.cell >= 0)
        if not np.any(found, axis=0).all():
            missing = int(np.flatnonzero(~np.any(found, axis=0))[0])
            raise ValueError(f"The probe at {x[missing].tolist()} is outside the mesh; move it inside.")
        first = np.argmax(found, axis=0)
        self.mine = np.flatnonzero(first == self.comm.rank)

    def values(self) -> list[np.ndarray]:
        """One array (points, components) per function, on every rank."""
        out = []
        for f in self.functions:
            size, (_, degree) = f.function_space.dofmap.index_map_bs, element_of(f.function_space)
            array, here = f.x.array.reshape(-1, size), np.zeros((self.number, size))
            cells = self.cell[self.mine]
            if degree == 0:
                here[self.mine] = array[cells]
            else:
                dofs = dof_table(f.function_space)[cells]
                here[self.mine] = np.einsum("pv,pvk->pk", self.weight[self.mine], array[dofs])
            out.append(self.comm.allreduce(here))
        return out

    @property
    def mesh(self) -> "Mesh":
        """The mesh of the functions."""
        return self.functions[0].function_space.mesh

    def saved(self) -> dict[str, tuple]:
        """What was recorded, for a checkpoint."""
        rows = {f"values_{k}": np.array([row[1 + k] for row in self.rows]) for k in range(len(self.functions))}
        return {"same": (None, {"time": np.array([row[0] for row in self.rows], float), **rows})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take it back."""
        same, shapes = state["same"], [np.shape(values) for values in self.values()]
        if sum(name.startswith("values_") for name in same) != len(shapes) or len(same["time"]) and any(
                same[f"values_{k}"].shape[1:] != shape for k, shape in enumerate(shapes)):
            raise ValueError("The probe of the checkpoint had other functions or another number of points; give Probe those "
                             "that it had when it was saved.")
        self.rows = [(float(t), *(same[f"values_{k}"][n] for k in range(len(self.functions))))
                     for n, t in enumerate(same["time"])]

    def record(self, time: float) -> None:
        """Keep the values at ``time``."""
        self.rows.append((finite_number("time", time), *self.values()))


class TimeAverage:
    """Time mean and variance of a Function, weighted with the steps (West 1979); takes no more room the longer it runs.

    Args:
        function: any Function.

    Attributes:
        mean, variance: arrays like ``function.x.array``; duration (float): time averaged over [s].
    """

    def __init__(self, function: "fem.Function") -> None:
        self.function, self.duration = function_of_mesh("function to average", function), 0.0
        self.mean, self._sum = np.zeros_like(function.x.array), np.zeros_like(function.x.array)

    def add(self, dt: float) -> None:
        """Add the present values with weight ``dt`` [s]."""
        dt = positive_number("time step", dt)
        self.duration += dt
        change = self.function.x.array - self.mean
        self.mean += change * dt / self.duration
        self._sum += dt * change * (self.function.x.array - self.mean)

    @property
    def variance(self) -> np.ndarray:
        """Variance over the time so far."""
        return self._sum / max(self.duration, 1e-300)

    @property
    def mesh(self) -> "Mesh":
        """The mesh of the function."""
        return self.function.function_space.mesh

    def saved(self) -> dict[str, tuple]:
        """Mean and sum of squares at the places of the owned values, for a checkpoint."""
        space = self.function.function_space
        own, size = space.dofmap.index_map.size_local, space.dofmap.index_map_bs
        rows = {name: a.reshape(-1, size)[:own] for name, a in (("mean", self.mean), ("sum", self._sum))}
        return {"values": (space.tabulate_dof_coordinates()[:own], rows), "same": (None, {"duration": self.duration})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take them back."""
        vector = self.function.x
        present, own = vector.array.copy(), state["values"]["mean"].size
        for array, name in ((self.mean, "mean"), (self._sum, "sum")):
            vector.array[:own] = state["values"][name].ravel()
            vector.scatter_forward()  # to the values of other ranks
            array[:] = vector.array
        vector.array[:] = present
        self.duration = float(state["same"]["duration"])
