"""Checkpoints: the state of a run in one HDF5 file, to go on from on any number of ranks."""
import hashlib
import io
import os
import re
import time
from pathlib import Path
from typing import Any

import numpy as np

from fe_el.checks import file_name
from fe_el.dolfinx_api import import_h5py
from fe_el.mesh.places import nearest
from fe_el.parallel.exchange import raise_everywhere

# A state is a dict: name -> (points, arrays). With points (rows, 3) the arrays have a row for each and find their places by
# these; without (``None``) they are rows that the part sorts out itself. The name "same" holds numbers that are alike on
# every rank. A part that makes lists or solvers anew when it is restored does so in ``anew()``, when it is saved, too.
KNOWN = "Particles", "Contacts", "VolumeAveragedNavierStokes", "Scalar", "Inlet"
VERSION = 2
HEADER = 512  # bytes before what HDF5 reads
STRAY = 600  # [s] after which the part of a file that a killed run left is removed


def save_checkpoint(path: str | Path, *parts: Any, **numbers: Any) -> None:
    """Write the state of particles, contacts, fluid, scalars, inlets and observers to an HDF5 file.

    The file is complete or not there: it gets its name when it is written, and begins with a checksum. The run that wrote it
    makes lists and solvers anew, as one that goes on from it must: on one rank both are the same to the last bit. On
    other ranks, and with a run that wrote none, they agree up to round-off and the solvers' tolerance.

    Args:
        path: file to write; an older one is replaced.
        parts: :class:`Particles`, :class:`Contacts`, :class:`VolumeAveragedNavierStokes`, :class:`Scalar`, :class:`Inlet`,
            :class:`Coupling`, :class:`TimeAverage`, :class:`Probe`, :class:`SubCycled`, :class:`ParaViewOutput`, steps of
            :func:`adaptive_steps`, and objects of a user's class that has ``saved()`` and ``restore(state)``
            (see this module's source), if need be ``anew()``; particles before their contacts, the first one with a
            mesh.
        numbers: what else to keep, for instance ``time=``; numbers, texts and arrays.

    Raises:
        TypeError: for a part that has no state to keep.
        OSError: if the file cannot be written; an older one stays as it was.

    Note:
        Collective.
    """
    path, comm, groups = file_name("path of a checkpoint", path), comm_of(parts), {}
    for k, part in enumerate(parts):
        for block, (points, arrays) in _part(part).saved().items():
            name = f"{k}_{type(part).__name__}/{block}"
            if block == "same":
                groups[name] = arrays
                continue
            arrays = arrays if points is None else {"points": points, **arrays}
            rows = {key: comm.gather(np.asarray(a)) for key, a in arrays.items()}
            if comm.rank == 0:
                groups[name] = {key: np.concatenate(a) for key, a in rows.items()}
    message = None
    if comm.rank == 0:
        try:
            _write(path, groups, numbers)
        except (OSError, TypeError, ValueError) as error:  # HDF5 takes neither dictionaries nor objects
            message = f"The checkpoint {path} cannot be written: {error}."
    raise_everywhere(comm, OSError, message)
    for part in parts:
        if hasattr(part, "anew"):
            part.anew()


def _write(path, groups, numbers):
    h5py = import_h5py()  # where a checkpoint is written, nowhere else
    memory = io.BytesIO()  # HDF5 does not survive a disk that is full
    with h5py.File(memory, "w", userblock_size=HEADER) as file:
        for name, arrays in groups.items():
            for key, a in arrays.items():
                file[f"{name}/{key}"] = a
        for key, a in numbers.items():
            file[f"numbers/{key}"] = a
    content = memory.getbuffer()[HEADER:]
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    for stray in path.parent.glob(f"*{path.suffix}.part"):
        if stray != part and time.time() - stray.stat().st_mtime > STRAY:
            stray.unlink(missing_ok=True)
    try:
        with open(part, "wb") as file:
            file.write(_header(content))
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


def _header(content):
    """What a checkpoint begins with: its version and the checksum of the rest."""
    text = f"fe_el checkpoint, version {VERSION}\nSHA-256 {hashlib.sha256(content).hexdigest()}\n"
    return text.encode().ljust(HEADER, b"\0")


def load_checkpoint(path: str | Path, *parts: Any) -> dict[str, Any]:
    """Give the parts of a run, set up as when it was saved, the state in a file; returns the numbers kept with it.

    Args:
        path: file of :func:`save_checkpoint`.
        parts: as when it was saved, in the same order; particles need not be inserted before.

    Returns:
        dict: the ``numbers``.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for a file that is damaged or of another version, other parts than were saved, or another mesh; the
            parts are then as they were.

    Note:
        Collective.
    """
    comm = comm_of(parts)
    data = _read_everywhere(path, comm)
    names = [f"{k}_{type(part).__name__}" for k, part in enumerate(parts)]
    saved = sorted({name for name in data if name != "numbers"}, key=lambda name: int(name.split("_")[0]))
    if names != saved:
        raise ValueError(f"The checkpoint {path} holds {[s.split('_')[1] for s in saved]}; load it into these parts in this "
                         f"order, "
                         f"not {[n.split('_')[1] for n in names]}.")
    states = [{block: _placed(comm, part, block, rows) for block, rows in data[name].items()}
              for name, part in zip(names, parts)]
    for part, state in zip(parts, states):
        _part(part).restore(state)
    return data.get("numbers", {})


def places_in(path: str | Path, comm: Any) -> np.ndarray:
    """Places (particles, 3) of the first particles that a checkpoint holds, on every rank [m].

    Raises:
        FileNotFoundError, ValueError: as :func:`load_checkpoint`, and for a checkpoint without particles.

    Note:
        Collective.
    """
    data = _read_everywhere(path, comm)
    of = sorted((int(name.split("_")[0]), name) for name in data if name.endswith("_Particles"))
    if not of:
        raise ValueError(f"The checkpoint {path} holds no particles; give one that does, or the places of the particles.")
    return data[of[0][1]]["particles"]["position"]


def _read_everywhere(path, comm):
    """What a file holds, on every rank, or the error that says why not. Collective."""
    data, message, path = None, None, file_name("path of a checkpoint", path)
    if comm.rank == 0:
        try:
            data, message = _read(path)
        except OSError as error:
            message = f"The checkpoint {path} cannot be read: {error}."
    missing = comm.bcast(comm.rank == 0 and not path.is_file())
    raise_everywhere(comm, FileNotFoundError if missing else ValueError, message)
    return comm.bcast(data)


def _read(path):
    """What a file holds, or ``None`` and what is wrong with it."""
    if not path.is_file():
        return None, f"There is no checkpoint {path}."
    content = path.read_bytes()
    if content[:HEADER] != _header(memoryview(content)[HEADER:]):
        theirs = re.match(rb"fe_el checkpoint, version (\d+)\n", content)
        what = ("plain HDF5, as fe_el 0.1.0 wrote it" if content.startswith(b"\x89HDF") else
                f"of version {int(theirs[1])}" if theirs and int(theirs[1]) != VERSION else "")
        if what:
            return None, (f"The checkpoint {path} is {what}, and this fe_el reads version {VERSION}; read it with the fe_el "
                          "that wrote it.")
        return None, (f"The file {path} is damaged, or no checkpoint of this version: its checksum is not that of its "
                      "content. Go on from an older one.")
    return _groups(content), None


def _groups(content):
    h5py = import_h5py()
    data = {}

    def visit(name, item):
        if isinstance(item, h5py.Dataset):
            *groups, key = name.split("/")
            place = data
            for group in groups:
                place = place.setdefault(group, {})
            value = item[()]
            place[key] = value.decode() if isinstance(value, bytes) else value
    with h5py.File(io.BytesIO(content), "r") as file:
        file.visititems(visit)
    return data


def _placed(comm, part, block, rows):
    """Rows with points in the order of this rank's own points; others as they are."""
    if "points" not in rows:
        return rows
    points = part.saved()[block][0]
    period = getattr((part if hasattr(part, "mesh") else part.fluid).mesh, "period", None)
    index, found = nearest(rows["points"], points, period)
    total = comm.allreduce(np.array([len(points), found.sum()]))
    if total[0] != len(rows["points"]) or total[1] != total[0]:
        raise ValueError(f"The checkpoint has {len(rows['points'])} {block}, the mesh {total[0]}, of which {total[1]} are "
                         f"in the same "
                         "places; load it into the mesh that it was made with.")
    return {key: a[index] for key, a in rows.items() if key != "points"}


def _part(part):
    """The part itself, if it has a state to keep."""
    if not hasattr(part, "saved") or not hasattr(part, "restore"):
        raise TypeError(f"A {type(part).__name__} has no state to keep; a checkpoint holds {', '.join(KNOWN)}, and objects "
                        "that have saved() and restore(state).")
    return part


def comm_of(parts):
    """Communicator of the first part."""
    if not parts:
        raise TypeError(f"Give a checkpoint the parts to keep: {', '.join(KNOWN)}.")
    part = parts[0]
    for name in ("particles", "fluid", "mesh"):
        part = getattr(part, name, part) if not hasattr(part, "comm") else part
    return part.comm
