"""Particles and fields as files for ParaView."""
import re
import sys
import time as time_now
from pathlib import Path

import meshio
import numpy as np

from fe_el.dolfinx_api import dof_table, element_of
from fe_el.mesh.cell_mesh import owned_corners
from fe_el.parallel.failures import PATIENCE, wait_for_all


class ParaViewOutput:
    """Writes particles and cell fields as .vtu pieces, one per rank, with .pvd collections for ParaView.

    In a folder that holds a series already, frames older than the first that is written stay: a restarted run goes on with
    the
    series. Used as a context (``with output: ...``) it remembers the state of every call of :meth:`write`; if the run stops
    with an
    error, it writes the last good state before the error goes on.

    Args:
        folder: where to write.
        particles (Particles): absent: none are written.
        fields: cell-wise (DG0) and nodal (P1) Functions of one mesh; absent: none are written.
        every (float): time between outputs [s]; absent: every call writes.

    Note:
        Collective.
    """

    def __init__(self, folder, particles=None, fields=(), every=None):
        self.folder, self.particles, self.fields, self.every = Path(folder), particles, list(fields), every
        self.comm = particles.comm if particles is not None else fields[0].function_space.mesh.comm
        self.seconds = {"output": 0.0}
        self.next_time, self.written = -np.inf, {"particles": [], "fluid": [], "times": []}
        self.guarding, self.remembered = False, None
        self.folder.mkdir(parents=True, exist_ok=True)
        if self.fields:
            corner, _ = owned_corners(self.fields[0].function_space.mesh)
            self.points, m = corner.reshape(-1, 3), corner.shape[1]
            self.cells = [({3: "triangle", 4: "tetra"}[m], np.arange(len(corner) * m).reshape(-1, m))]

    def write(self, time):
        """Write the state at ``time`` [s], unless the last output is more recent than ``every``."""
        tick = time_now.perf_counter()
        if self.guarding:
            self.remembered = (time, self._particle_data(), [f.x.array.copy() for f in self.fields])
        if time >= self.next_time - 1e-12:
            if self.every:
                self.next_time = (time if self.next_time == -np.inf else self.next_time) + self.every
            self._write(time, self._particle_data(), [f.x.array for f in self.fields])
        self.seconds["output"] += time_now.perf_counter() - tick

    def __enter__(self):
        self.guarding = True
        return self

    def __exit__(self, kind, error, trace):
        self.guarding = False
        if error is not None and self.remembered is not None and not isinstance(error, KeyboardInterrupt):
            time = self.remembered[0]
            if not self.written["times"] or time > self.written["times"][-1]:
                self._write(*self.remembered, patience=PATIENCE)  # other ranks may not come here
            if self.comm.rank == 0:
                print(f"The run stopped after time {time:g} s; {self.folder} has the last good state.", file=sys.stderr)
        return False

    def _write(self, time, particles, values, patience=np.inf):
        self.written["times"].append(time)
        fluid = self._fluid_data(values)
        if particles is not None:
            position, data = particles
            vertices = [("vertex", np.arange(len(position)).reshape(-1, 1))]
            self._piece("particles", time, meshio.Mesh(position, vertices, point_data=data), patience)
        if fluid is not None:
            cell_data, point_data = fluid
            self._piece("fluid", time, meshio.Mesh(self.points, self.cells, point_data=point_data, cell_data=cell_data),
                        patience)

    def _particle_data(self):
        """Copies of what is written of the particles; ``None`` without particles."""
        p = self.particles
        if p is None:
            return None
        names = ("velocity", "angular_velocity", "diameter", "id")
        data = {name: getattr(p, name).copy() for name in names}
        data |= {name: a.copy() for name, a in p.properties.items() if not name.startswith("_")}
        return p.position.copy(), data

    def _fluid_data(self, arrays):
        """What is written of the fields with these values, cell by cell; ``None`` without fields."""
        if not self.fields:
            return None
        cell_data, point_data, n = {}, {}, len(self.cells[0][1])
        for f, array in zip(self.fields, arrays):
            size, (_, degree) = f.function_space.dofmap.index_map_bs, element_of(f.function_space)
            values = array.reshape(-1, size)
            if size == 2:
                values = np.column_stack([values, np.zeros(len(values))])
            values = values[:, 0] if size == 1 else values
            if degree == 0:
                cell_data[f.name] = [values[:n].copy()]
            else:
                dofs = dof_table(f.function_space)[:n]
                point_data[f.name] = values[dofs.ravel()]
        return cell_data, point_data

    def _frames(self, name, time):
        """Frames of the collection in the folder that are older than ``time``: those of the run that goes on. Collective."""
        frames, path = {}, self.folder / f"{name}.pvd"
        if self.comm.rank == 0 and path.is_file():
            for when, file in re.findall(r'timestep="([^"]+)" part="\d+" file="([^"]+)"', path.read_text()):
                if float(when) < time * (1 - 1e-9) - 1e-300 and (self.folder / file).is_file():
                    frames.setdefault(float(when), []).append(file)
        return self.comm.bcast(sorted(frames.items()))

    def _piece(self, name, time, piece, patience):
        if not self.written[name]:
            self.written[name] = self._frames(name, time)
        number = 1 + max((int(files[0].split("_")[-2]) for _, files in self.written[name]), default=-1)
        files = [f"{name}_{number:05d}_{r}.vtu" for r in range(self.comm.size)]
        meshio.write(self.folder / files[self.comm.rank], piece, file_format="vtu")
        self.written[name].append((time, files))
        wait_for_all(self.comm, patience)  # the collection names pieces that are whole, those of other ranks too
        if self.comm.rank == 0:
            rows = "".join(f'<DataSet timestep="{t:.9g}" part="{r}" file="{f}"/>\n' for t, fs in self.written[name]
                           for r, f in enumerate(fs))
            part = self.folder / f".{name}.pvd.part"
            part.write_text('<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">'
                            f"<Collection>\n{rows}</Collection></VTKFile>\n")
            part.replace(self.folder / f"{name}.pvd")  # the collection is whole at any moment
