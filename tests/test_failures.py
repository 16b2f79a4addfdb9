"""Errors under mpirun end the run on all ranks, and say so once; a disk that is full leaves whole frames."""
import subprocess
import sys
import time

import pytest

SCENE = """
import sys
import time
from pathlib import Path
import fe_el
mesh, tags = fe_el.box((0.01, 0.01), (4, 4))
beads = fe_el.Particles(mesh, 2500.0)
if mesh.comm.rank == 1:
    Path(sys.argv[2]).write_text(str(time.time()))
if sys.argv[1] == "one" and mesh.comm.rank == 1:
    raise RuntimeError("only here")
mesh.comm.barrier()
if sys.argv[1] == "all":
    raise RuntimeError("everywhere")
"""


@pytest.mark.parametrize("where, said", [("one", "this error came on rank 1"), ("all", "this error came on all ranks")])
def test_an_error_ends_all_ranks_with_one_message(tmp_path, mpirun, where, said):
    """Started as README says, an error of the user's own on one rank or on all: over in seconds, one traceback."""
    script = tmp_path / "scene.py"
    script.write_text(SCENE)
    run = mpirun(2, "-m", "mpi4py", str(script), where, str(tmp_path / "began"))
    assert run.returncode and said in run.stderr and run.stderr.count("Traceback (most recent call last)") == 1
    assert time.time() - float((tmp_path / "began").read_text()) < 60


RESTARTED = """
import sys
import fe_el
mesh, tags = fe_el.box((0.01, 0.01), (4, 4))
beads = fe_el.Particles(mesh, 2500.0)
beads.insert_at([[0.005, 0.005]], 1e-4)
output = fe_el.ParaViewOutput(sys.argv[1], beads, every=1.0)
output.restore({"same": {"next_time": 1.0}})
with output:
    output.write(0.5)
    if mesh.comm.rank == 1:
        raise RuntimeError("only here")
    mesh.comm.barrier()
"""


def test_a_failing_rank_of_a_restarted_run_waits_for_nobody(tmp_path, mpirun):
    """It has a last good state, and no frame yet: the list of frames would come from the first rank, which is elsewhere."""
    script = tmp_path / "scene.py"
    script.write_text(RESTARTED)
    run = mpirun(2, "-m", "mpi4py", str(script), str(tmp_path / "out"))
    assert run.returncode and "this error came on rank 1" in run.stderr and "only here" in run.stderr


FULL = """
import resource, signal, sys
import fe_el
mesh, tags = fe_el.box((0.01, 0.01), (4, 4))
beads = fe_el.Particles(mesh, 2500.0)
beads.insert_at([[0.005, 0.005]], 1e-4)
output = fe_el.ParaViewOutput(sys.argv[1], beads)
output.write(0.5)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (220, 220))
try:
    output.write(1.0)
except OSError as error:
    print("said:", error)
"""


def test_a_full_disk_leaves_whole_frames_only(tmp_path):
    """Here a limit of the file size; the cut piece of the frame that did not fit is gone."""
    run = subprocess.run([sys.executable, "-W", "ignore", "-c", FULL, str(tmp_path)], capture_output=True, text=True,
                         timeout=120)
    assert run.returncode == 0 and "cannot be written" in run.stdout and "Make room" in run.stdout, run.stderr
    assert sorted(f.name for f in tmp_path.iterdir()) == ["particles.pvd", "particles_00000_0.vtu"]
    assert (tmp_path / "particles.pvd").read_text().count("<DataSet") == 1
