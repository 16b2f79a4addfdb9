"""Errors under mpirun end the run on all ranks, and say so once."""
import shutil
import subprocess
import sys
import time

import pytest

from fe_el.parallel.failures import environment_outside_mpirun

SCENE = """
import sys
import fe_el
mesh, tags = fe_el.box((0.01, 0.01), (4, 4))
beads = fe_el.Particles(mesh, 2500.0)
if sys.argv[1] == "one" and mesh.comm.rank == 1:
    raise RuntimeError("only here")
if sys.argv[1] == "all":
    raise RuntimeError("everywhere")
mesh.comm.barrier()
"""


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
@pytest.mark.parametrize("where, said", [("one", "this error came on rank 1"), ("all", "this error came on all ranks")])
def test_an_error_ends_all_ranks_with_one_message(tmp_path, where, said):
    """Started as README says, an error of the user's own on one rank or on all: over in seconds, one traceback."""
    script = tmp_path / "scene.py"
    script.write_text(SCENE)
    clean = environment_outside_mpirun() | {
        "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_rmaps_base_oversubscribe": "1", "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}
    start = time.monotonic()
    run = subprocess.run(["mpirun", "-n", "2", sys.executable, "-m", "mpi4py", str(script), where],
                         capture_output=True, text=True, timeout=120, env=clean, stdin=subprocess.DEVNULL)
    assert run.returncode and said in run.stderr and run.stderr.count("Traceback (most recent call last)") == 1
    assert time.monotonic() - start < 60
