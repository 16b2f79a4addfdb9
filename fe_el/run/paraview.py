"""Particles and fields as files for ParaView."""
import re
import sys
import time as time_now
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import meshio
import numpy as np

from fe_el.checks import finite_number, function_of_mesh, positive_number
from fe_el.dolfinx_api import dof_table, element_of
from fe_el.mesh.cell_mesh import owned_corners
from fe_el.parallel.exchange import raise_everywhere
from fe_el.parallel.failures import PATIENCE, wait_for_all
from fe_el.run.stopping import STOPPED

if TYPE_CHECKING:
    from dolfinx import fem

    from fe_el.particles.contacts.contacts import Contacts
    from fe_el.particles.particles import Particles

WRITTEN = ("velocity", "angular_velocity", "diameter", "density", "material", "id", "coarse_graining", "force",
           "contact_force")  # of the particles, beside the user's properties


def _write_piece(file, piece):
    """Write a .vtu file, whole or not at all; a piece without points, of which nothing can be compressed, as it is."""
    try:
        meshio.write(file, piece, "vtu", compression="zlib" if len(piece.points) else None)
    except OSError:
        file.unlink(missing_ok=True)
        raise


class ParaViewOutput:
    """Writes particles, cell fields and contacts as compressed .vtu pieces, one per rank, with .pvd collections (ParaView).

    Particles have velocity and angular velocity, diameter, density, material, number (id), coarse graining, the ``force``
    by all but contacts and gravity, the ``contact_force`` [N], and the user's properties. Contacts between
    particles are lines between their centres, see :meth:`Contacts.network`.

    In a folder that holds a series already, frames older than the first that is written stay: a restarted run goes on with
    the series; from a checkpoint that holds this output, at the times of the unbroken run. Used as a context (``with
    output: ...``) it remembers the state of every call of :meth:`write`; if the run stops with an error, it writes
    the last good state before the error goes on.

    Args:
        folder: where to write.
        particles (Particles): absent: none are written.
        fields: cell-wise (DG0) and nodal (P1) Functions of one mesh; absent: none are written.
        every (float): time between outputs [s]; absent: every call writes.
        contacts (Contacts): absent: none are written.

    Raises:
        ValueError: for something else than these, or nothing to write.

    Note:
        Collective.
    """

    def __init__(self, folder: str | Path, particles: "Particles | None" = None, fields: "Sequence[fem.Function]" = (),
                 every: float | None = None, contacts: "Contacts | None" = None) -> None:
        if not isinstance(folder, (str, Path)):
            raise ValueError(f"The folder of the output is {folder!r}; give its name.")
        if not isinstance(fields, (list, tuple)) or particles is None and not fields:
            raise ValueError(f"The output has the fields {str(fields)[:60]} and particles {particles!r}; give particles, "
                             "or a list of Functions, or both.")
        for name, thing in (("particles", particles), ("contacts", contacts)):
            if thing is not None and (isinstance(thing, type) or not hasattr(thing, "layout")):
                raise ValueError(f"The {name} of the output are {thing!r}; pass the object, or leave it out.")
        self.folder, self.particles, self.contacts = Path(folder), particles, contacts
        self.fields = [function_of_mesh("field of the output (fields)", f) for f in fields]
        self.every = None if every is None else positive_number("time between outputs (every)", every)
        self.comm = particles.comm if particles is not None else self.fields[0].function_space.mesh.comm
        self.seconds = {"output": 0.0}
        self.next_time, self.guarding = -np.inf, False
        self.written: dict[str, list] = {"particles": [], "contacts": [], "fluid": [], "times": []}
        self.remembered: tuple | None = None  # the last good state
        self.folder.mkdir(parents=True, exist_ok=True)
        if self.fields:
            corner, _ = owned_corners(self.fields[0].function_space.mesh)
            self.points, m = corner.reshape(-1, 3), corner.shape[1]
            self.cells = [({3: "triangle", 4: "tetra"}[m], np.arange(len(corner) * m).reshape(-1, m))]

    def write(self, time: float) -> None:
        """Write the state at ``time`` [s], unless the last output is more recent than ``every``."""
        time, tick = finite_number("time of the output", time), time_now.perf_counter()
        if self.guarding:
            self.remembered = (time, self._particle_data(), self._contact_data(), [f.x.array.copy() for f in self.fields])
        if time >= self.next_time - 1e-12:
            if self.every:
                self.next_time = (time if self.next_time == -np.inf else self.next_time) + self.every
            self._write(time, self._particle_data(), self._contact_data(), [f.x.array for f in self.fields])
        self.seconds["output"] += time_now.perf_counter() - tick

    def __enter__(self) -> "ParaViewOutput":
        self.guarding = True
        return self

    def __exit__(self, kind, error, trace):
        self.guarding = False
        told = isinstance(error, KeyboardInterrupt) or isinstance(error, SystemExit) and error.code == STOPPED
        if error is not None and self.remembered is not None and not told:
            time, said = self.remembered[0], f"{self.folder} has the last good state"
            if not self.written["times"] or time > self.written["times"][-1]:
                try:
                    self._write(*self.remembered, patience=PATIENCE)  # other ranks may not come here
                except OSError as failed:
                    said = f"the last good state is not written: {failed}"
            if self.comm.rank == 0:
                print(f"The run stopped after time {time:g} s; {said}.", file=sys.stderr)
        return False

    def saved(self) -> dict[str, tuple]:
        """When the next frame is due, for a checkpoint."""
        return {"same": (None, {"next_time": self.next_time})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take it back."""
        self.next_time = float(state["same"]["next_time"])

    def _write(self, time, particles, contacts, values, patience=np.inf):
        self.folder.mkdir(parents=True, exist_ok=True)
        self.written["times"].append(time)
        fluid = self._fluid_data(values)
        if particles is not None:
            position, data = particles
            vertices = [("vertex", np.arange(len(position)).reshape(-1, 1))]
            self._piece("particles", time, meshio.Mesh(position, vertices, point_data=data), patience)
        if contacts is not None:
            ends, data = contacts
            lines = [("line", np.arange(2 * len(ends)).reshape(-1, 2))]
            self._piece("contacts", time, meshio.Mesh(ends.reshape(-1, 3), lines, cell_data=data), patience)
        if fluid is not None:
            cell_data, point_data = fluid
            self._piece("fluid", time, meshio.Mesh(self.points, self.cells, point_data=point_data, cell_data=cell_data),
                        patience)

    def _particle_data(self):
        """Copies of what is written of the particles; ``None`` without particles."""
        p = self.particles
        if p is None:
            return None
        data = {name: getattr(p, name).copy() for name in WRITTEN}
        data |= {name: a.copy() for name, a in p.properties.items() if not name.startswith("_")}
        return p.position.copy(), data

    def _contact_data(self):
        """Ends of the lines and what is written of them; ``None`` without contacts."""
        if self.contacts is None:
            return None
        network = self.contacts.network()
        ends = network.pop("position")
        return ends, {name: [a] for name, a in network.items()}

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
            if np.isfinite(patience) and not wait_for_all(self.comm, patience):
                raise OSError("Other ranks did not come to write")
            self.written[name] = self._frames(name, time)
        number = 1 + max((int(files[0].split("_")[-2]) for _, files in self.written[name]), default=-1)
        files = [f"{name}_{number:05d}_{r}.vtu" for r in range(self.comm.size)]
        self._or_all_fail(patience, _write_piece, self.folder / files[self.comm.rank], piece)
        self.written[name].append((time, files))
        self._or_all_fail(patience, self._collect, name)  # names pieces that are whole, those of other ranks too

    def _or_all_fail(self, patience, call, *args):
        """Call on this rank; an error of the disk comes on all of them, if they come here within the patience [s]."""
        message = None
        try:
            call(*args)
        except OSError as error:
            message = f"The output {self.folder} cannot be written: {error}. Make room, or give another folder."
        if np.isinf(patience):
            raise_everywhere(self.comm, OSError, message)
        elif not wait_for_all(self.comm, patience) or message:
            raise OSError(message or "Other ranks did not come to write")

    def _collect(self, name):
        """Write the collection, whole at any moment."""
        if self.comm.rank == 0:
            rows = "".join(f'<DataSet timestep="{t:.9g}" part="{r}" file="{f}"/>\n' for t, fs in self.written[name]
                           for r, f in enumerate(fs))
            part = self.folder / f".{name}.pvd.part"
            try:
                part.write_text('<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">'
                                f"<Collection>\n{rows}</Collection></VTKFile>\n")
                part.replace(self.folder / f"{name}.pvd")
            except OSError:
                part.unlink(missing_ok=True)
                raise
