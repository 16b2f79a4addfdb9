"""summary.json: what a run ends with, its costs by stage and the versions that its numbers depend on."""
import importlib.metadata
import json
import math
import sys
import warnings
from pathlib import Path
from typing import Any

from mpi4py import MPI

from fe_el.compiled.compile_time import compile_seconds
from fe_el.dolfinx_api import FOUND
from fe_el.parallel.exchange import raise_everywhere


def stage_seconds(*parts: Any) -> dict[str, Any]:
    """Wall time of every active stage: ``seconds_per_stage`` and a flat ``seconds_<stage>`` each.

    Args:
        parts: objects with a dictionary ``seconds``; ``None`` stands for physics that the scene leaves out.
    """
    for part in parts:
        if part is not None and not hasattr(part, "seconds"):
            raise ValueError(f"{part!r} has no stages; pass objects that count their seconds, such as Contacts, or None.")
    stages = {name: round(t, 6) for part in parts if part is not None for name, t in part.seconds.items()}
    return {"seconds_per_stage": stages, **{"seconds_" + name: t for name, t in stages.items()}}


def versions():
    """Versions of what the numbers depend on, as flat keys."""
    out = {"python": sys.version.split()[0]} | {"version_" + name: version for name, version in FOUND.items()}
    for name in ("fe_el", "petsc4py", "numba", "numpy"):
        try:
            out["version_" + name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return out


def write_summary(folder: str | Path, comm: MPI.Comm = MPI.COMM_WORLD, **numbers: Any) -> dict[str, Any]:
    """Write ``folder/summary.json`` with flat keys in SI units, ranks and versions; returns the dictionary.

    ``seconds_compilation`` is the wall time that numba has compiled for on this rank, in whichever stages that was.

    A number that is not finite stands there as null, and a warning names it. No rank goes on before the file is there, nor
    before rank 0 has written what it wrote earlier (tables, pictures): what a run leaves can be read after it on any rank.

    Note:
        Collective.

    Raises:
        ValueError: for what is no number, text, array, list or dictionary of these, or a folder that is no name.
        OSError: where the file cannot be written, on all ranks.
    """
    if not isinstance(folder, (str, Path)):
        raise ValueError(f"The folder of the summary is {folder!r}; give its name.")
    out = {**numbers, "seconds_compilation": round(compile_seconds(), 3), "ranks": comm.size, **versions()}
    bad: list[str] = []
    plain = _plain(out, "", bad)
    fault = None
    if comm.rank == 0:
        if bad:
            warnings.warn(f"The summary in {folder} has no finite number for {', '.join(bad)}: null.", RuntimeWarning,
                          stacklevel=2)
        try:
            Path(folder).mkdir(parents=True, exist_ok=True)
            (Path(folder) / "summary.json").write_text(json.dumps(plain, indent=1) + "\n")
        except OSError as error:
            fault = f"The summary cannot be written in {folder}: {error}."
    raise_everywhere(comm, OSError, fault)
    return out


def _plain(value, name, bad):
    """What JSON has for a value, its numbers finite or ``None``; the names of those that are not are put into ``bad``."""
    if isinstance(value, dict):
        return {str(k): _plain(v, f"{name}.{k}".lstrip("."), bad) for k, v in value.items()}
    if hasattr(value, "tolist"):  # numpy's numbers and arrays
        return _plain(value.tolist(), name, bad)
    if isinstance(value, (list, tuple)):
        return [_plain(v, name, bad) for v in value]
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if not isinstance(value, float):
        raise ValueError(f"The summary's {name} is {value!r}; give numbers, texts, arrays, lists or dictionaries of these.")
    if math.isfinite(value):
        return value
    bad.append(name)
    return None
