"""A bed that is killed at random moments and started again with --restart: nothing before the last checkpoint is lost.

Each time the run gets SIGKILL at a random moment, then goes on from its folder. At the end its particles are those of the
run without a break, to round-off, and its series of frames is whole. SIGTERM, where it is sent, must give exit code 75.
    python demos/benchmarks/kill_and_restart.py --kills 20
"""
import argparse
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import fe_el

DEMO = Path(__file__).resolve().parents[1] / "contacts_only.py"
OPTIONS = ["--diameter", "4e-3", "--particles", "300", "--settle-time", "0.05", "--end-time", "0.3",
           "--output-every", "0.02", "--checkpoint-every", "0.01"]


def arguments():
    """Command line of the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--kills", type=int, default=20, help="how often the run is killed (20)")
    p.add_argument("--signal", default="SIGKILL", choices=["SIGKILL", "SIGTERM"], help="what it gets (SIGKILL)")
    p.add_argument("--seed", type=int, default=1, help="of the moments (1)")
    p.add_argument("--output", default="out/kill_and_restart", help="folder for results (out/kill_and_restart)")
    return p


def start(folder):
    """The run, going on from its folder if it can."""
    command = [sys.executable, "-W", "ignore", str(DEMO), *OPTIONS, "--restart", "--output", str(folder)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def finish(folder):
    """Run to the end; wall time [s]."""
    tick, run = time.perf_counter(), start(folder)
    said = run.communicate()[1]
    if run.returncode:
        raise RuntimeError(f"The run ended with exit code {run.returncode}: {said[-2000:]}")
    return time.perf_counter() - tick


def main(kills=20, signal_name="SIGKILL", seed=1, output="out/kill_and_restart"):
    """Kill and restart, compare with the run without a break, and return the summary."""
    moments, folder = random.Random(seed), Path(output)
    whole = finish(folder / "whole")
    codes, slowest = [], 0.0
    while len(codes) < kills:
        run = start(folder / "broken")
        time.sleep(moments.uniform(0.0, whole))
        tick = time.perf_counter()
        if run.poll() is None:
            os.kill(run.pid, getattr(signal, signal_name))
        run.communicate()
        if run.returncode == 0:  # it came to its end before that: begin again
            for file in (folder / "broken").iterdir():
                file.unlink()
            continue
        slowest = max(slowest, time.perf_counter() - tick)
        codes.append(run.returncode)
    finish(folder / "broken")
    sums = [json.loads((folder / k / "summary.json").read_text()) for k in ("whole", "broken")]
    energy = [s["kinetic_energy"] for s in sums]
    frames = [re.findall('timestep="([^"]+)"', (folder / k / "particles.pvd").read_text()) for k in ("whole", "broken")]
    return fe_el.write_summary(folder, kills=kills, exit_codes=sorted(set(codes)), slowest_end=slowest,
                               same_frames=frames[0] == frames[1], frames=len(frames[0]),
                               left_mass_difference=abs(sums[0]["left_mass"] - sums[1]["left_mass"]),
                               kinetic_energy_difference=abs(energy[0] - energy[1]) / max(*energy, 1e-300),
                               lost_particles=sums[1]["lost_particles"], stray_files=len(list(folder.rglob("*.part"))))


if __name__ == "__main__":
    options = vars(arguments().parse_args())
    options["signal_name"] = options.pop("signal")
    for key, value in main(**options).items():
        print(f"{key:32s} {value}")
