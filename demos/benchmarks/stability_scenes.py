"""Scenes of the stability map: a fluid alone in a box, with one parameter far out of the ordinary."""
from mpi4py import MPI  # isort: skip (the wheels of dolfinx find their MPI through it)
import numpy as np
from dolfinx import fem

import fe_el
from fe_el.dolfinx_api import scalar_space, vector_space

PI, PERIOD = np.pi, 20  # steps in which a redrawn void fraction goes up and down
DEFAULTS = {"reynolds": 1e4, "courant": 0.5, "drag_number": 0.0, "drag": None, "redraw": False, "void": None, "motion": None,
            # box 1 m, 1 m/s
            "density": 1.0, "stretch": 1.0, "angle": None, "swirl": None, "spread": 1.0, "stabilisation": None}
VOIDS, DRAGS = (0.9, 0.7, 0.5, 0.36, 0.1, 0.01), (0.0, 1e-2, 1.0, 1e2, 1e4, 1e6, 1e8)
TOGETHER = {"drag, void": {"drag_number": 1e8, "void": 0.36}, "slivers, void": {"angle": 0.1, "void": 0.36},
            "slivers, drag": {"angle": 0.1, "drag_number": 1e8}, "stretch, drag": {"stretch": 100.0, "drag_number": 1e8}}
AXES = {  # axis: label, values, the parameters of a value
    "reynolds": ("Reynolds number", tuple(10.0 ** k for k in range(-6, 8)), lambda v: {"reynolds": v}),
    "courant": ("Courant number", (0.1, 0.3, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0), lambda v: {"courant": v}),
    "drag": ("drag number dt beta / rho", DRAGS, lambda v: {"drag_number": v}),
    "drag_redrawn": ("drag number, redrawn at each step", DRAGS, lambda v: {"drag_number": v, "redraw": True}),
    "void_static": ("lowest void fraction, random", VOIDS, lambda v: {"void": v}),
    "void_redrawn": ("lowest void fraction, redrawn", VOIDS, lambda v: {"void": v, "motion": "redrawn"}),
    "void_carried": ("lowest void fraction, carried", VOIDS, lambda v: {"void": v, "motion": "carried"}),
    "density": ("fluid density [kg/m^3]", tuple(10.0 ** k for k in range(-3, 5)), lambda v: {"density": v, "drag": 1e3}),
    "stretch": ("aspect ratio of the cells", (1.0, 3.0, 10.0, 30.0, 100.0, 1000.0), lambda v: {"stretch": v}),
    "slivers": ("least angle [degrees], Re 1e6", (30.0, 10.0, 3.0, 1.0, 0.3, 0.1, 0.01),
                lambda v: {"angle": v, "reynolds": 1e6}),
    "outlet": ("swirl / stream at an outlet, Re 1e6", (0.5, 1.0, 2.0, 4.0, 8.0), lambda v: {"swirl": v, "reynolds": 1e6}),
    "step_spread": ("spread of random time steps", (1.0, 10.0, 100.0, 1e3, 1e4), lambda v: {"spread": v}),
    "stabilisation": ("stabilisation, Re 1e7", ("none", "Streamline", "Upwind"),
                      lambda v: {"reynolds": 1e7, "stabilisation": None if v == "none" else getattr(fe_el, v)()}),
    "together": ("together, Re 1e7", tuple(TOGETHER), lambda v: {"reynolds": 1e7, **TOGETHER[v]}),
}


def sliver_box(cells, angle, seed=1):
    """Unit box with every inner vertex moved; half the squares have their centre near a side, for this least angle
    [degrees]."""
    mesh, tags = fe_el.box((1.0, 1.0), (cells, cells))
    rng, x = np.random.default_rng(seed), mesh.geometry.x
    grid = np.stack(np.meshgrid(*2 * [np.arange(cells + 1.0)], indexing="ij"), 2) / cells
    grid[1:-1, 1:-1] += rng.uniform(-0.15, 0.15, (cells - 1, cells - 1, 2)) / cells
    side, flat = rng.integers(0, 4, (cells, cells)), rng.integers(0, 2, (cells, cells)) > 0
    half = np.rint(2 * cells * x[:, :2]).astype(int)
    i, j = half.T // 2
    centre = (half % 2 > 0).all(1)
    x[~centre, :2] = grid[i, j][~centre]
    i, j = i[centre], j[centre]
    corner = np.stack([grid[i, j], grid[i + 1, j], grid[i + 1, j + 1], grid[i, j + 1]])
    a, b = (corner[(side[i, j] + k) % 4, np.arange(len(i))] for k in (0, 1))
    inwards = np.column_stack([a[:, 1] - b[:, 1], b[:, 0] - a[:, 0]])
    x[centre, :2] = np.where(flat[i, j][:, None], 0.5 * (a + b + np.tan(np.radians(angle)) * inwards), corner.mean(0))
    return mesh, tags


def least_angle(air):
    """Least angle of the triangles [degrees]."""
    along = [air.corner[:, (k + 1) % 3] - air.corner[:, k] for k in range(3)]
    cross = [np.arctan2(2 * air.volume, -(along[k] * along[k - 1]).sum(1)) for k in range(3)]
    return np.degrees(air.comm.allreduce(np.min(cross), op=MPI.MIN))


class Scene:
    """A fluid with its fields: ``advance`` makes a step, ``energy`` is the kinetic energy [J].

    Args:
        cells (int): crossed squares across the box.
        time_order (int): of the fluid.
        roughness (float): standard deviation of the cells' random part of the velocity at the start [m/s].
        changes: parameters that differ from ``DEFAULTS``.
    """

    def __init__(self, cells, time_order=2, roughness=0.3, **changes):
        c = self.case = {**DEFAULTS, **changes}
        self.roughness = roughness
        self.mesh, self.tags = (sliver_box(cells, c["angle"]) if c["angle"] else fe_el.box((2.0, 1.0), (2 * cells, cells))
                                if c["swirl"] else fe_el.periodic_box((1.0, 1 / c["stretch"]), (cells, cells)))
        self.rng = np.random.default_rng(7 + self.mesh.comm.rank)
        scalar, vector = scalar_space(self.mesh, "DG", 0), vector_space(self.mesh, "DG", 0)
        self.fields = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
        air = self.air = self.fluid(time_order)
        self.steps = np.random.default_rng(5)
        self.count, self.phase = air.num_cells, self.rng.uniform(0, 2 * PI, air.num_cells)
        self.random, self.modes = self.rng.integers(0, 2, self.count), np.random.default_rng(3).uniform(-1, 1, 6)
        self.draw(0.0, 0)
        q = self.start_velocity()
        self.air.set_initial_velocity(q)
        fastest = air.comm.allreduce(np.linalg.norm(q, axis=1).max(initial=0.0), op=MPI.MAX)
        self.dt = c["courant"] * air.comm.allreduce(np.median(air.h), op=MPI.MIN) / fastest
        self.beta = c["drag_number"] * c["density"] / self.dt if c["drag"] is None else c["drag"]
        self.fields[1].x.array[:self.count] = self.beta * self.random

    def start_velocity(self):
        """The start as a short step projects it: free of divergence, and without momentum where momentum is kept."""
        air, c, first = self.air, self.case, self.fluid(1)
        start, weight = self.start(0.0, air.corner.mean(1)), self.fields[0].x.array[:self.count, None] * air.volume[:, None]
        if not (c["motion"] or c["swirl"]):  # it keeps its momentum, and energy with it
            start -= air.comm.allreduce((weight * start).sum(0)) / air.comm.allreduce(weight.sum())
        first.set_initial_velocity(start)
        first.advance(1e-9, self.fields)
        return first.velocity.x.array.reshape(-1, 2)[:self.count].copy()

    def fluid(self, time_order):
        """The fluid, with its boundaries."""
        c = self.case
        air = fe_el.VolumeAveragedNavierStokes(self.mesh, self.tags, c["density"], c["density"] / c["reynolds"],
                                               time_order=time_order, stabilisation=c["stabilisation"])
        if c["swirl"]:
            air.set_velocity(1, (1.0, 0.0))
            air.set_pressure(2)
        return air

    def start(self, t, x):
        """Vortex and rough part; for an outlet a round vortex in a stream."""
        c, scale = self.case, 1 / self.case["stretch"]
        if c["swirl"]:
            r = (x[:, :2] - (1.3, 0.5)) / 0.15
            return (1.0, 0.0) + c["swirl"] * np.exp(0.5 - 0.5 * (r ** 2).sum(1))[:, None] * r[:, ::-1] * (-1, 1)
        a, b = 2 * PI * x[:, 0], 2 * PI * x[:, 1] / scale
        vortex = np.column_stack([np.sin(a) * np.cos(b), -scale * np.cos(a) * np.sin(b)])
        return vortex + self.rng.normal(0, self.roughness, (len(x), 2)) + ((1.0, 0.0) if c["motion"] == "carried" else 0.0)

    def draw(self, t, step):
        """Void fraction of a time [s]: random in cells, oscillating in each of them, or a pattern that the stream
        carries."""
        x, motion, low = self.air.corner.mean(1), self.case["motion"], self.case["void"] or 1.0
        wave = 2.0 * self.random - 1
        if motion == "redrawn":
            wave = np.sin(2 * PI * step / PERIOD + self.phase)
        elif motion == "carried":
            wave = sum(np.sin(2 * PI * ((k + 1) * (x[:, 0] - t) + (k % 3) * x[:, 1] + q)) for k,
                       q in enumerate(self.modes)) / 6
        if motion:  # the box is closed: as much void everywhere together at all times
            wave = wave - self.air.comm.allreduce(self.air.volume @ wave) / self.air.comm.allreduce(self.air.volume.sum())
            wave = wave / max(1.0, -self.air.comm.allreduce(wave.min(initial=0.0), op=MPI.MIN))
        self.fields[0].x.array[:self.count] = 0.5 * (1 + low) + 0.5 * (1 - low) * wave

    def advance(self):
        """One step."""
        if self.case["motion"]:
            self.draw(self.air.time + self.dt, self.air.step + 1)
        if self.case["redraw"]:
            self.fields[1].x.array[:self.count] = self.beta * self.rng.integers(0, 2, self.count)
        self.air.advance(self.dt * self.case["spread"] ** -self.steps.uniform(), self.fields)

    def energy(self):
        """Kinetic energy of the cells."""
        q, phi = self.air.velocity.x.array.reshape(-1, 2)[:self.count], self.fields[0].x.array[:self.count]
        return self.air.comm.allreduce(0.5 * self.air.density * float((phi * self.air.volume) @ (q ** 2).sum(1)))

    def fallbacks(self):
        """Solves that needed a stronger method."""
        closed = self.air._closed_flux
        solvers = [self.air.pressure_equation.solver, self.air.transport_solver] + ([closed.solver] if closed else [])
        return sum(s.fallbacks for s in solvers)


