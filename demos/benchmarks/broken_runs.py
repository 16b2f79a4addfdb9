"""A bed whose run is broken in each way that a machine breaks runs, and then goes on: what is lost, and how soon it ends.

The harm comes a while after the first checkpoint is there: a signal to the run or to mpirun, SIGKILL to one rank of two, a
disk that is full (a tmpfs of a few hundred kB, which needs root), a folder that is deleted. Then the run goes on with
--restart in what is left of its folder, and its end is compared with that of the run without a break.
    python demos/benchmarks/broken_runs.py
"""
import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import fe_el
from fe_el.parallel.failures import environment_outside_mpirun

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from demos.benchmarks.kill_and_restart import DEMO, OPTIONS

CASES = [(harm, ranks) for harm in ("SIGTERM", "SIGINT", "SIGKILL of a rank", "full disk", "folder deleted")
         for ranks in (1, 2)]
PATIENCE = 120.0  # [s] after which a run counts as one that hangs


def arguments():
    """Command line of the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--disk", type=int, default=300, help="size of the disk that is full [kB] (300)")
    p.add_argument("--output", default="out/broken_runs", help="folder for results (out/broken_runs)")
    return p


def start(folder, ranks):
    """The run, on a number of ranks, going on from its folder if it can."""
    environment = environment_outside_mpirun() | {
        "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}
    launch = [sys.executable, "-W", "ignore"] if ranks == 1 else ["mpirun", "-n", str(ranks), sys.executable, "-W", "ignore",
                                                                 "-m", "mpi4py"]
    with open(str(folder) + ".txt", "w") as said:
        return subprocess.Popen([*launch, str(DEMO), *OPTIONS, "--restart", "--output", str(folder)], env=environment,
                                stdin=subprocess.DEVNULL, stdout=said, stderr=said, start_new_session=True)


def ranks_of(run):
    """Processes that mpirun has started."""
    return [int(child) for child in Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()]


def broken(harm, run, ranks, folder):
    """Do harm to a run that has written a checkpoint; seconds from then (or its last file) to its end."""
    if harm == "full disk":
        run.wait(PATIENCE)
        return time.time() - max(file.stat().st_mtime for file in folder.iterdir())
    until = time.monotonic() + PATIENCE
    while not (folder / "checkpoint.h5").is_file() and run.poll() is None and time.monotonic() < until:
        time.sleep(0.01)
    time.sleep(0.3)
    tick = time.monotonic()
    if harm == "folder deleted":
        shutil.rmtree(folder)
    elif harm == "SIGKILL of a rank":
        os.kill(run.pid if ranks == 1 else ranks_of(run)[-1], signal.SIGKILL)
    else:
        os.kill(run.pid, getattr(signal, harm))
    try:
        run.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        os.killpg(run.pid, signal.SIGKILL)
    return time.monotonic() - tick


def case(harm, ranks, folder, disk):
    """Break a run and finish it: what there is to say of it."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    if harm == "full disk" and subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={disk}k", "tmpfs", str(folder)],
                                              capture_output=True).returncode:
        return None  # not root
    try:
        run = start(folder, ranks)
        seconds = broken(harm, run, ranks, folder)
        kept = shutil.copytree(folder, str(folder) + "_kept", dirs_exist_ok=True) if folder.is_dir() else None
    finally:
        if harm == "full disk":
            subprocess.run(["umount", str(folder)], check=True)
    if harm == "full disk":
        shutil.copytree(kept, folder, dirs_exist_ok=True)
    said = Path(str(folder) + ".txt").read_text()
    stray = len(list(folder.rglob("*.part"))) if folder.is_dir() else 0
    there = (folder / "checkpoint.h5").is_file()
    end = start(folder, ranks).wait()
    return {"exit_code": run.returncode, "seconds": seconds, "checkpoint": there, "stray_files": stray, "goes_on": end == 0,
            "tracebacks": said.count("Traceback (most recent"), "last_words": said.strip().splitlines()[-1] if said else ""}


def compared(folder, whole):
    """What the run that went on differs in from the one without a break."""
    sums = [json.loads((k / "summary.json").read_text()) for k in (whole, folder)]
    frames = [re.findall('timestep="([^"]+)"', (k / "particles.pvd").read_text()) for k in (whole, folder)]
    energy = [s["kinetic_energy"] for s in sums]
    return {"kinetic_energy_difference": abs(energy[0] - energy[1]) / max(*energy, 1e-300),
            "left_mass_difference": abs(sums[0]["left_mass"] - sums[1]["left_mass"]), "same_frames": frames[0] == frames[1],
            "lost_particles": sums[1]["lost_particles"]}


def main(cases=CASES, disk=300, output="out/broken_runs"):
    """Break a run in each way and return the summary."""
    folder, numbers = Path(output).resolve(), {}
    folder.mkdir(parents=True, exist_ok=True)
    for ranks in sorted({ranks for _, ranks in cases}):
        start(folder / f"whole_{ranks}", ranks).wait()
    for harm, ranks in cases:
        name = f"{harm.replace(' ', '_')}_{ranks}"
        found = case(harm, ranks, folder / name, disk)
        if found and found["goes_on"]:
            found |= compared(folder / name, folder / f"whole_{ranks}")
        numbers[name] = found or "needs root"
    return fe_el.write_summary(folder, **numbers)


if __name__ == "__main__":
    for key, value in main(**vars(arguments().parse_args())).items():
        print(f"{key:32s} {value}")
