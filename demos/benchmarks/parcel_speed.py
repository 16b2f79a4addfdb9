"""Cost of parcels in the jet in cross flow, from ten thousand to a million: processor time of each stage of a step."""
import argparse
import logging
import resource
import sys
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from demos import jet_in_cross_flow as jet

STAGES = ("injection", "mapping_and_drag", "answer", "tracking")
IN_THE_JET = 19_000 * 20.0 ** 3  # parcels times the cube of the coarse graining


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--numbers", type=int, nargs="+", default=(10_000, 100_000, 1_000_000), help="of parcels")
    p.add_argument("--steps", type=int, default=10, help="steps of which the median is taken")
    p.add_argument("--time-step", type=float, default=4.9e-5, help="[s]")
    p.add_argument("--cells", type=int, nargs=2, default=(90, 35), help="squares along and across, four triangles each")
    p.add_argument("--output", default="out/parcel_speed", help="folder for results")
    return p


def scene_of(number, cells):
    """The jet with as many parcels, spread over the channel behind the slot, at the velocity of the air."""
    scene = jet.Jet(coarse_graining=(IN_THE_JET / number) ** (1 / 3), cells=cells)
    large = (IN_THE_JET / number) ** (1 / 3) * jet.LARGE
    count = np.where(np.arange(number) % 2, 1.0, (jet.LARGE / jet.SMALL) ** 3) * (large / jet.LARGE) ** 3
    scene.parcels.insert_in_box((0.3, 0.01), (jet.LENGTH, 0.4), number, large, velocity=(jet.CROSS_FLOW, 0.0), number=count)
    return scene


def seconds_of(scene, dt, steps):
    """Seconds of each stage of a step (stages,): medians of the processor's time. The fluid stands still."""
    rows = []
    for _ in range(steps + 2):  # the first two compile
        ticks = [time.process_time()]
        for stage in (scene.jet.advance, scene.coupling.to_fluid, scene.coupling.to_particles, scene.parcels.advance):
            stage(dt)
            ticks.append(time.process_time())
        rows.append(np.diff(ticks))
    return np.median(rows[2:], 0)


def main(numbers=(10_000, 100_000, 1_000_000), steps=10, time_step=4.9e-5, cells=(90, 35), output="out/parcel_speed",
         progress=True):
    """Time all numbers of parcels and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    out, rows = {}, []
    for number in numbers:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        scene = scene_of(number, cells)
        rows.append(seconds_of(scene, time_step, steps))
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        own, user = scene.parcels.arrays()
        arrays = sum(a.nbytes for a in (*own.values(), *user.values()))
        out[f"bytes_per_parcel_{number}"] = arrays / len(scene.parcels)
        out[f"peak_bytes_per_parcel_{number}"] = 1024 * grown / number  # of the first: with all that the program needs
        for stage, seconds in zip(STAGES, rows[-1]):
            out[f"nanoseconds_per_parcel_{stage}_{number}"] = 1e9 * seconds / number
        out[f"million_parcel_steps_per_second_{number}"] = number / rows[-1].sum() / 1e6
        if progress and MPI.COMM_WORLD.rank == 0:
            print(number, {k: round(v, 3) for k, v in out.items() if k.endswith(f"_{number}")}, flush=True)
    if len(numbers) > 1:
        for stage, seconds in zip((*STAGES, "all"), (*np.transpose(rows), np.sum(rows, 1))):
            out[f"exponent_{stage}"] = np.polyfit(np.log(numbers), np.log(seconds), 1)[0]
    return fe_el.write_summary(output, MPI.COMM_WORLD, **out)


if __name__ == "__main__":
    summary = main(**vars(arguments().parse_args()))
    if MPI.COMM_WORLD.rank == 0:
        for key, value in summary.items():
            print(f"{key:32s} {value}")
