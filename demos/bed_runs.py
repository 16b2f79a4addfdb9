"""What the demos of beds share: the loop with its records, the ledger, the stages of the wall time, profiles and
snapshots."""
import time
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

import fe_el


class Bed(NamedTuple):
    """Beads in a gas; what a scene leaves out is ``None``."""

    beads: "fe_el.Particles"
    contacts: "fe_el.Contacts"
    air: "fe_el.VolumeAveragedNavierStokes" = None
    coupling: "fe_el.Coupling" = None


class Ledger:
    """Largest errors of the balances that were recorded, and the wall time of the records."""

    def __init__(self, bed):
        self.bed, self.seconds = bed, {"records": 0.0}
        self.solid, self.momentum, self.mass, self.fullest = 0.0, 0.0, 0.0, 0.0

    def saved(self):
        """The largest errors so far, for a checkpoint."""
        return {"same": (None, {"largest": np.array([self.solid, self.momentum, self.mass, self.fullest])})}

    def restore(self, state):
        """Take them back."""
        self.solid, self.momentum, self.mass, self.fullest = state["same"]["largest"].tolist()

    def record(self, each, now):
        """The balances of the step just made, and what the demo itself records of it."""
        tick = time.perf_counter()
        coupling = self.bed.coupling
        if coupling is not None:
            self.solid = max(self.solid, coupling.solid_volume_error)
            self.momentum = max(self.momentum, coupling.momentum_imbalance)
            self.mass = max(self.mass, self.bed.air.mass_residual())
            self.fullest = max(self.fullest, coupling.max_solid_fraction)
        each(now)
        self.seconds["records"] += time.perf_counter() - tick

    def summary(self):
        """Flat keys for summary.json."""
        if self.bed.coupling is None:
            return {}
        return {"solid_volume_error": self.solid, "momentum_imbalance": self.momentum, "mass_residual": self.mass,
                "max_solid_fraction": self.fullest, "over_filled_cells": self.bed.coupling.over_filled_total}


def run(bed, end_time, out, each, restarts, every=10, kept=(), after=None, progress=True):
    """Advance a bed to ``end_time``, from the start or from a checkpoint.

    Args:
        out: ParaViewOutput.
        each: called with the time at every ``every``-th step and the last, where the ledger is looked at too.
        restarts (Restarts): when the state is written, and what the run goes on from.
        kept: what of the demo checkpoints keep, too.
        after: called with the time after every step; ``None``: nothing.

    Returns:
        dict: ledger, wall time, seconds of every stage and of what is in none, lost beads.
    """
    beads, contacts, air, coupling = bed
    ledger, dt = Ledger(bed), restarts.dt
    checkpoints = restarts.checkpoints(beads, contacts, air, coupling, out, ledger, *kept)
    number, first = beads.next_id, 1 + round(checkpoints.time / dt)
    before, tick = fe_el.stage_seconds(contacts, air, coupling, out, ledger)["seconds_per_stage"], time.perf_counter()
    processor = time.process_time()
    with checkpoints:
        for step, now in enumerate(restarts.steps(checkpoints.time, end_time, progress), first):
            if air is not None:
                coupling.to_fluid(dt)
                air.advance(dt, coupling.fields)
                coupling.to_particles(dt)
            beads.advance(dt, contacts)
            if step % every == 0 or now > end_time - 0.5 * dt:
                ledger.record(each, now)
            out.write(now)
            if after is not None:
                after(now)
            checkpoints.after(now)
        if restarts.every:
            checkpoints.save()  # of the end, from which a longer run can go on
    wall = time.perf_counter() - tick
    processor = beads.comm.allreduce(time.process_time() - processor)
    stages = fe_el.stage_seconds(contacts, air, coupling, out, ledger)["seconds_per_stage"]
    stages = {name: round(seconds - before[name], 6) for name, seconds in stages.items()}
    stages["rest"] = round(wall - sum(stages.values()), 6)
    return {"particles": number, "lost_particles": number - beads.total_number, "time_step": dt, "end_time": end_time,
            "wall_time": wall, "processor_time": processor, "seconds_per_stage": stages,
            **{"seconds_" + name: t for name, t in stages.items()},
            **ledger.summary(), **beads.imbalance(),
            "contact_steps_per_fluid_step": contacts.steps_last,
            "largest_overlap_over_diameter": float(beads.comm.allreduce(contacts.largest_overlap, op=MPI.MAX))}




def pressure_drop(air, axis=2):
    """Mean pressure at the lowest nodes above that of the outlet, less the weight of the gas column [Pa]; outlet at zero.

    Note:
        Collective.
    """
    z, own = air.node_position[:, axis], air.owned_nodes
    low, high = -air.comm.allreduce(-z.min(), op=MPI.MAX), air.comm.allreduce(z.max(), op=MPI.MAX)
    bottom = z[:own] < low + 1e-9 * (high - low)
    total = air.comm.allreduce(np.array([air.pressure.x.array[:own][bottom].sum(), bottom.sum()]))
    return total[0] / total[1] + air.density * air.gravity[axis] * (high - low)


class Averages:
    """Time means in boxes of space: solid fraction and vertical velocity of the beads, each bead spread over 29 points.

    Args:
        beads: the beads.
        columns, rows: edges of the boxes along x and z [m]; their depth is ``depth`` [m].
    """

    def __init__(self, beads, columns, rows, depth):
        self.beads, self.columns, self.rows, self.depth, self.count = beads, np.asarray(columns), np.asarray(rows), depth, 0
        shape = len(rows) // 2, len(columns) - 1
        self.volume, self.flux, self.squares = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self.points = fe_el.mapping.isotropic_points()

    def saved(self):
        """Sums of all ranks so far, for a checkpoint."""
        volume, flux = (self.beads.comm.allreduce(a) for a in (self.volume, self.flux))
        return {"same": (None, {"volume": volume, "flux": flux, "count": self.count})}

    def restore(self, state):
        """Take them back, on the first rank."""
        same, first = state["same"], self.beads.comm.rank == 0
        self.volume[:], self.flux[:] = (same[name] if first else 0.0 for name in ("volume", "flux"))
        self.count = int(same["count"])

    def add(self):
        """Add the present state; collective only in the end."""
        p = self.beads
        for k in range(len(self.volume)):
            low, high = self.rows[2 * k:2 * k + 2]
            near = np.flatnonzero(np.abs(p.position[:, 2] - 0.5 * (low + high)) < 0.5 * (high - low) + p.diameter)
            at = p.position[near, None] + 0.5 * p.diameter[near, None, None] * self.points
            inside = (at[:, :, 2] >= low) & (at[:, :, 2] < high)
            share = np.where(inside, (p.volume[near] / len(self.points))[:, None], 0.0)
            x = at[:, :, 0].ravel()
            self.volume[k] += np.histogram(x, self.columns, weights=share.ravel())[0]
            self.flux[k] += np.histogram(x, self.columns, weights=(share * p.velocity[near, 2:]).ravel())[0]
        self.count += 1

    def means(self):
        """Void fraction and mean vertical velocity (rows, columns); collective."""
        volume, flux = (self.beads.comm.allreduce(a) for a in (self.volume, self.flux))
        box = np.diff(self.columns) * self.depth * (self.rows[1::2] - self.rows[::2])[:, None]
        return 1 - volume / (self.count * box), flux / np.maximum(volume, 1e-300)


def standard_error(values, blocks=10):
    """Standard error of the mean of a correlated series, from the means of blocks."""
    parts = [b.mean() for b in np.array_split(np.asarray(values), blocks) if len(b)]
    return float(np.std(parts, ddof=1) / np.sqrt(len(parts))) if len(parts) > 1 else float("nan")


def gathered(beads, *names):
    """Arrays of all ranks' beads in the order of their numbers, on rank 0; elsewhere ``None``."""
    parts = beads.comm.gather([beads.id, *(getattr(beads, n) for n in names)])
    if parts is None:
        return None
    whole = [np.concatenate([p[i] for p in parts]) for i in range(len(names) + 1)]
    order = np.argsort(whole[0])
    return [a[order] for a in whole[1:]]


def draw_beads(axis, snapshot, colour, width, height, title, **style):
    """Beads from the front, nearest last: circles of their size, in a panel ``width`` by ``height`` [m]."""
    from matplotlib.collections import EllipseCollection
    x, d = snapshot["position"], snapshot["diameter"]
    order = np.argsort(-x[:, 1])
    shown = EllipseCollection(d[order], d[order], np.zeros(len(d)), units="xy", offsets=x[order][:, [0, 2]],
                              array=colour[order],
                              transOffset=axis.transData, lw=0.1, edgecolor="0.3", **style)
    axis.add_collection(shown)
    axis.set(aspect="equal", xlim=(0, width), ylim=(0, height), title=title, xticks=[0, width])
    axis.set_xticklabels(["0", f"{width * 1e3:g}"])
    axis.tick_params(labelsize=8)
    return shown
