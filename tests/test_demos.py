"""Every demo, small."""
import json

import pytest

from demos import fluidised_bed


@pytest.mark.ranks
def test_fluidised_bed(tmp_path_factory):
    from mpi4py import MPI
    folder = MPI.COMM_WORLD.bcast(str(tmp_path_factory.mktemp("bed")) if MPI.COMM_WORLD.rank == 0 else None)
    fluidised_bed.main(slice=0.1, end_time=2e-3, time_step=1e-4, output=folder, progress=False)
    MPI.COMM_WORLD.barrier()
    with open(folder + "/summary.json") as file:
        summary = json.load(file)
    assert summary["particles"] == 2772 + 1794 and summary["lost_particles"] == 0
    assert summary["solid_volume_error"] < 1e-12 and summary["momentum_imbalance"] < 1e-10
    assert summary["mass_residual"] < 1e-6
    assert abs(summary["bed_weight_per_area"] - 2154) < 3


@pytest.mark.ranks
def test_dry_bed_imports_no_fluid(tmp_path_factory):
    import subprocess
    import sys
    code = ("import sys; sys.argv = ['x']; sys.path.insert(0, '.'); from demos import fluidised_bed as f; "
            f"f.main(0.0, 2e-3, slice=0.1, output={str(tmp_path_factory.mktemp('dry'))!r}, progress=False); "
            "assert not any(m.startswith(('fe_el.fluid', 'fe_el.coupling')) for m in sys.modules)")
    import os
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_", "PMIX_"))}
    from mpi4py import MPI
    if MPI.COMM_WORLD.rank == 0:
        from pathlib import Path
        subprocess.run([sys.executable, "-c", code], check=True, env=clean, cwd=Path(__file__).parent.parent)
