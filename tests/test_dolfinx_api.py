"""What differs between dolfinx's versions: said in one sentence when it does not fit, in one file, and the same for all."""
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI

import fe_el
from fe_el import dolfinx_api as api

ROOT = Path(__file__).resolve().parents[1]
CHANGED = (r"\.FunctionSpace\(|VectorFunctionSpace|VectorElement|MixedElement|\.functionspace\(|dofmap\.array"
           r"|list\.array|ufl_element\(|gmshio|dolfinx\.__version__|LinearProblem|import h5py|BoundingBoxTree|\._cpp_object"
           r"|\.VERSION|\.OLD\b|\.NEW\b|import .*\b(OLD|NEW|VERSION)\b|hasattr\((dolfinx|fem|PETSc|ufl|basix|dmesh), ")


@pytest.mark.parametrize("package, said", [
    ("raise ModuleNotFoundError('No module named dolfinx')", "found none (No module named dolfinx);"),
    ("__version__ = '0.7.3'", "found dolfinx 0.7.3;"), ("__version__ = '1.2.0.dev0'", "found dolfinx 1.2.0.dev0;")])
def test_a_dolfinx_that_is_missing_or_unknown_is_said_in_one_sentence(tmp_path, package, said):
    """The first import of fe_el ends in what was found and what to do."""
    (tmp_path / "dolfinx").mkdir()
    (tmp_path / "dolfinx" / "__init__.py").write_text(package)
    run = subprocess.run([sys.executable, "-c", "import fe_el"], capture_output=True, text=True,
                         env={**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"})
    last = run.stderr.strip().splitlines()[-1]
    assert run.returncode and said in last and last.startswith("ImportError: fe_el needs dolfinx (0.5, 0.9, 0.11)")
    assert "python3-dolfinx" in last and "pip install dolfinx-solver-real" in last and "another exception" not in run.stderr


def test_only_one_file_knows_that_there_are_several_versions():
    """Nothing else in the library, its demos or its tests uses what changed, or asks for a version."""
    for folder in ("fe_el", "demos", "tests"):
        for path in (ROOT / folder).rglob("*.py"):
            found = re.search(CHANGED, path.read_text())
            assert path.name in ("dolfinx_api.py", "test_dolfinx_api.py") or not found, f"{path}: {found and found[0]}"


@pytest.mark.ranks
@pytest.mark.parametrize("slices_along", [None, 0])
def test_a_mesh_from_arrays_has_ghosts_tags_and_spaces(slices_along):
    """Handed in on one rank: its volume, the area of tagged facets, and integrals of both kinds of functions are exact."""
    n, comm = 4, MPI.COMM_WORLD
    box = dmesh.create_box(MPI.COMM_SELF, [np.zeros(3), np.ones(3)], [n] * 3)
    cells, x = api.geometry_nodes(box).astype(np.int64), box.geometry.x
    corners = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]])
    facets = cells[:, corners].reshape(-1, 3)
    facets = np.unique(np.sort(facets[(x[facets, 0] == 1.0).all(1)], 1), axis=0)
    if comm.rank:
        cells, x, facets = cells[:0], x[:0], facets[:0]
    from fe_el.mesh.partition import create_mesh
    mesh = create_mesh(comm, cells, x, slices_along)
    tags = api.tags_by_vertices(mesh, 2, facets, np.full(len(facets), 7))
    fe_el.Particles(mesh, 1.0)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    total = lambda form: comm.allreduce(fem.assemble_scalar(fem.form(form)))
    p, u = fem.Function(api.scalar_space(mesh, "P", 1)), fem.Function(api.vector_space(mesh, "DG", 0))
    assert api.element_of(p.function_space) == ("P", 1) and api.element_of(u.function_space) == ("DG", 0)
    assert api.dof_table(p.function_space).shape[1] == 4 and api.dof_table(u.function_space).shape[1] == 1
    p.interpolate(lambda x: x[0] + 2 * x[1])
    u.interpolate(lambda x: x)
    assert total(p * ds(7)) == pytest.approx(2.0) and total(fem.Constant(mesh, 1.0) * ds(7)) == pytest.approx(1.0)
    assert total(ufl.dot(u, ufl.grad(p)) * ufl.dx) == pytest.approx(1.5)


@pytest.mark.ranks
def test_a_mesh_without_ghosts_is_refused():
    """On several ranks, facets between them would be taken for boundaries."""
    mesh = dmesh.create_rectangle(MPI.COMM_WORLD, [np.zeros(2), np.ones(2)], [6, 6], ghost_mode=dmesh.GhostMode.none)
    if mesh.comm.size == 1:
        assert len(fe_el.Particles(mesh, 1.0)) == 0
        return
    for make in (lambda: fe_el.Particles(mesh, 1.0), lambda: fe_el.VolumeAveragedNavierStokes(mesh)):
        with pytest.raises(ValueError, match="no ghost cells between its ranks.*shared_facet"):
            make()
