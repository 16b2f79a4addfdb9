"""Time loop with progress, ParaView output and summary.json."""
import importlib.metadata
import json
import re
import sys
import time as time_now
from pathlib import Path

import meshio
import numpy as np
from mpi4py import MPI
from tqdm import tqdm

from fe_el.checks import numbers, positive_number
from fe_el.dolfinx_api import dof_table, element_of
from fe_el.failures import PATIENCE, wait_for_all
from fe_el.mesh import owned_corners


def time_steps(dt, end_time, start=0.0, comm=MPI.COMM_WORLD, progress=True):
    """Yield the times start + dt, start + 2 dt, ... up to end_time, with a progress bar and the time left.

    Raises:
        ValueError: for a step that is not positive or an end before the start.
    """
    dt = positive_number("time step", dt)
    if not numbers("end and start of the run", [end_time, start])[0] > start:
        raise ValueError(f"The time step is {dt} and the run goes from {start} to {end_time}; give a positive step and an "
                         "end after the start.")
    number = int(np.ceil((end_time - start) / dt - 1e-9))
    with tqdm(total=number, disable=not progress or comm.rank > 0, unit="step", file=sys.stderr, mininterval=1.0) as bar:
        for k in range(1, number + 1):
            yield start + k * dt
            bar.update()


class adaptive_steps:  # noqa: N801  called like time_steps
    """Yield (time, dt) up to end_time with steps that keep the fluid's Courant number |u| dt / h at ``courant``.

    Call ``fluid.advance(dt)`` in the loop. A step never grows by more than ``growth``; it shrinks at once. A checkpoint that
    holds these steps goes on with the last one.

    Args:
        first (float): first step [s]; absent: by the Courant number of the initial velocity.
        largest (float): bound of the steps, for instance from :mod:`fe_el.time_scales` [s].

    Attributes:
        dt (float): the last step [s]; ``None`` before the first.

    Raises:
        ValueError: for numbers that are not positive, a growth below one, or if neither ``first`` nor ``largest`` is given
            and
            the fluid is at rest.

    Note:
        Collective.
    """

    def __init__(self, fluid, end_time, courant=0.5, first=None, largest=np.inf, growth=1.2, progress=True):
        for name, value in (("courant", courant), ("largest", largest), ("end_time", end_time),
                            ("first", 1.0 if first is None else first)):
            if not numbers(name, value) > 0:
                raise ValueError(f"{name} is {value}; it must be greater than zero.")
        if not growth >= 1:
            raise ValueError(f"growth is {growth}; it must be at least 1.")
        self.fluid, self.end_time, self.courant, self.first = fluid, end_time, courant, first
        self.largest, self.growth, self.progress, self.dt = largest, growth, progress, None
        self._steps = None

    def __iter__(self):
        return self

    def __next__(self):
        self._steps = self._steps or self._all()
        return next(self._steps)

    def _all(self):
        time = self.fluid.time
        with tqdm(total=self.end_time - time, disable=not self.progress or self.fluid.comm.rank > 0, unit="s",
                  file=sys.stderr, mininterval=1.0) as bar:
            while time < self.end_time * (1 - 1e-12):
                self.dt = self._step(self.end_time - time)
                time += self.dt
                yield time, self.dt
                bar.update(self.dt)

    def _step(self, left):
        """The next step, with ``left`` [s] to go."""
        rate = self.fluid.courant(1.0)
        wanted = min(self.courant / rate if rate > 0 else np.inf, self.largest)
        last, grows = self.dt or self.first or np.inf, self.growth if self.dt is not None or self.fluid.step else 1.0
        dt = min(wanted, grows * last)
        if not np.isfinite(dt):
            raise ValueError("The fluid is at rest, so its Courant number gives no step; pass first= or largest= [s].")
        return left if dt > 0.999999 * left else min(dt, 0.5 * left) if dt > 0.5 * left else dt

    def saved(self):
        """The last step, for a checkpoint."""
        return {"same": (None, {"dt": np.nan if self.dt is None else self.dt})}

    def restore(self, state):
        """Take it back."""
        self.dt = None if np.isnan(state["same"]["dt"]) else float(state["same"]["dt"])


def stage_seconds(*parts):
    """Wall time of every active stage: ``seconds_per_stage`` and a flat ``seconds_<stage>`` each.

    Args:
        parts: objects with a dictionary ``seconds``; ``None`` stands for physics that the scene leaves out.
    """
    stages = {name: round(t, 6) for part in parts if part is not None for name, t in part.seconds.items()}
    return {"seconds_per_stage": stages, **{"seconds_" + name: t for name, t in stages.items()}}


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


def versions():
    """Versions of what the numbers depend on, as flat keys."""
    out = {"python": sys.version.split()[0]}
    for name in ("fe_el", "fenics-dolfinx", "petsc4py", "numba", "numpy"):
        try:
            out["version_" + name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return out


def write_summary(folder, comm=MPI.COMM_WORLD, **numbers):
    """Write ``folder/summary.json`` with flat keys in SI units, ranks and versions; returns the dictionary."""
    out = {**numbers, "ranks": comm.size, **versions()}
    if comm.rank == 0:
        Path(folder).mkdir(parents=True, exist_ok=True)
        plain = {k: v.item() if hasattr(v, "item") else v for k, v in out.items()}
        (Path(folder) / "summary.json").write_text(json.dumps(plain, indent=1) + "\n")
    return out
