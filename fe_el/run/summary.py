"""summary.json: what a run ends with, its costs by stage and the versions that its numbers depend on."""
import importlib.metadata
import json
import sys
from pathlib import Path

from mpi4py import MPI


def stage_seconds(*parts):
    """Wall time of every active stage: ``seconds_per_stage`` and a flat ``seconds_<stage>`` each.

    Args:
        parts: objects with a dictionary ``seconds``; ``None`` stands for physics that the scene leaves out.
    """
    stages = {name: round(t, 6) for part in parts if part is not None for name, t in part.seconds.items()}
    return {"seconds_per_stage": stages, **{"seconds_" + name: t for name, t in stages.items()}}


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
