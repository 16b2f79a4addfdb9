"""Scenes of ``fluid_error.py``, for fe_el, Taylor-Hood elements and icoFoam: a drifting vortex and a lid-driven cavity.

Every function returns what it measured at n x n squares: cells, seconds and error. fe_el and Taylor-Hood split a square into
four triangles.
"""
import csv
import sys
import time
from pathlib import Path

import mpi4py.MPI  # noqa: F401  # isort: skip (the wheels of dolfinx find their MPI through it)
import numpy as np
from dolfinx import fem
from scipy.interpolate import RegularGridInterpolator

import fe_el
from fe_el.dolfinx_api import vector_space
from fe_el.mesh.cell_mesh import barycentric_maps, owned_corners

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from demos.peers import ico_foam
from demos.peers.taylor_hood import TaylorHood

REFERENCE = Path(__file__).resolve().parents[2] / "tests" / "reference"
VORTEX_VISCOSITY, DRIFT, END, LENGTH = 0.01, np.array([1.0, 0.5]), 1.0, 2 * np.pi
CAVITY_VISCOSITY = 1e-3
FE_EL_STEP, TAYLOR_HOOD_STEP, ICO_FOAM_COURANT = 0.2, 1.0, 3.2  # the least error per second; icoFoam diverges at 6.4
TICK = 0.01  # of icoFoam's clock [s]


def march(air, dt, steps):
    """Seconds of a run; its first step, which sets up, counts as the mean of the others."""
    air.advance(dt)
    start = time.perf_counter()
    for _ in range(steps - 1):
        air.advance(dt)
    return (time.perf_counter() - start) * steps / (steps - 1)


# -- vortex ------------------------------------------------------------------------------------------------------------


def vortex(time, x):
    """Velocity of a Taylor-Green vortex that drifts and decays."""
    a, b, fade = x[:, 0] - DRIFT[0] * time, x[:, 1] - DRIFT[1] * time, np.exp(-2 * VORTEX_VISCOSITY * time)
    return DRIFT + fade * np.column_stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)])


def relative_error(weight, found, x):
    """L2 error at the end over the L2 norm of the vortex without its drift, from values at points x with weights."""
    exact = vortex(END, x)
    return float(np.sqrt((weight * ((found - exact) ** 2).sum(1)).sum() / (weight * ((exact - DRIFT) ** 2).sum(1)).sum()))


def steps_of(n):
    """Steps to the end at Courant number 0.4 of a square, at the largest speed 2."""
    return int(np.ceil(END / (0.4 * LENGTH / n / 2)))


def vortex_of_fe_el(n):
    """Cells, seconds and relative error of fe_el."""
    mesh, _ = fe_el.periodic_box((LENGTH,) * 2, (n, n))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.0, VORTEX_VISCOSITY, tolerance=1e-6)
    air.set_initial_velocity(vortex)
    seconds = march(air, END / steps_of(n), steps_of(n))
    found = air.velocity.x.array.reshape(-1, 2)[:air.num_cells]
    return {"cells": air.num_cells, "seconds": seconds, "error": relative_error(air.volume, found, air.corner.mean(1))}


def vortex_of_taylor_hood(n, explicit):
    """Cells, seconds and relative error of Taylor-Hood, at Courant number 0.4 of its nodes, two to a square's edge."""
    mesh, _ = fe_el.periodic_box((LENGTH,) * 2, (n, n))
    air = TaylorHood(mesh, 1.0, VORTEX_VISCOSITY, explicit=explicit)
    air.set_initial_velocity(vortex)
    seconds = march(air, END / steps_of(2 * n), steps_of(2 * n))
    corner, _ = owned_corners(mesh)
    _, volume = barycentric_maps(corner, 2)
    return {"cells": len(corner), "seconds": seconds, "error": relative_error(volume, air.at_cells(), corner.mean(1))}


def vortex_of_ico_foam(n, folder, ddt):
    """Cells, seconds and relative error of icoFoam."""
    pairs = {"left": ("right", "x-"), "right": ("left", "x+"), "low": ("top", "y-"), "top": ("low", "y+")}
    cyclic = ("type cyclic;", "type cyclic;")
    patches = {k: ("cyclic", f"neighbourPatch {other};", face, *cyclic) for k, (other, face) in pairs.items()}
    patches["faces"] = ("empty", "", "z- z+", "type empty;", "type empty;")
    c = (np.arange(n) + 0.5) * LENGTH / n
    x, steps = np.column_stack([a.ravel() for a in np.meshgrid(c, c)]), steps_of(n)
    ico_foam.write_case(folder, (LENGTH, LENGTH, LENGTH / n), (n, n, 1), patches, VORTEX_VISCOSITY, END / steps, steps,
                        ico_foam.vectors(vortex(0.0, x)), ddt)
    seconds = ico_foam.run(folder)
    return {"cells": n * n, "seconds": max(float(seconds[-1] - seconds[0]) * steps / (steps - 1), TICK),
            "error": relative_error(np.ones(n * n), ico_foam.final_velocity(folder, n * n), x)}


# -- cavity ------------------------------------------------------------------------------------------------------------


def centre_lines():
    """Points (points, 3), components, and the values of Botella and Peyret and of Ghia et al. there.

    The points are 128ths. At 128 squares they are nodes of fe_el, where linear interpolation adds no error: 96 compares
    better.
    """
    def read(name):
        with open(REFERENCE / name) as file:
            rows = [r for r in csv.DictReader(file) if r["Re"] == "1000"]
        return {(r["line"][0], float(r["coord"])): float(r["value_as_printed"]) for r in rows}
    precise, ghia = read("botella_peyret1998_cavity.csv"), read("ghia1982_cavity.csv")
    at = [round(128 * c) / 128 for _, c in precise]  # what is printed is rounded
    x = [(0.5, c, 0.0) if line == "u" else (c, 0.5, 0.0) for (line, _), c in zip(precise, at)]
    component = np.array(["uv".index(line) for line, _ in precise])
    return np.array(x), component, np.array([(v, ghia[k]) for k, v in precise.items()])


def compared(cells, seconds, velocity):
    """The row of a cavity; velocity(points (points, 3)) gives (points, 2)."""
    x, component, values = centre_lines()
    off = np.abs(np.asarray(velocity(x))[np.arange(len(x)), component][:, None] - values).max(0)
    return {"cells": cells, "seconds": seconds, "error": float(off[0]), "deviation_from_ghia": float(off[1])}


def cavity_of_fe_el(n, end_time):
    """Cells, seconds and deviations of fe_el's nodal velocity."""
    mesh, tags = fe_el.box((1.0, 1.0), (n, n))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.0, CAVITY_VISCOSITY, tolerance=1e-6, time_order=1)
    air.set_velocity(4, (1.0, 0.0))
    for side in (1, 2, 3):
        air.set_no_slip(side)
    seconds = march(air, FE_EL_STEP, round(end_time / FE_EL_STEP))
    nodal = fem.Function(vector_space(mesh, "P", 1))
    nodal.x.array.reshape(-1, 2)[:] = air.nodal_velocity
    return compared(air.num_cells, seconds, lambda x: fe_el.Probe([nodal], x).values()[0])


def cavity_of_taylor_hood(n, end_time):
    """Cells, seconds and deviations of Taylor-Hood."""
    mesh, tags = fe_el.box((1.0, 1.0), (n, n))
    lid = tags.values == 4
    air = TaylorHood(mesh, 1.0, CAVITY_VISCOSITY, [(tags.indices[lid], (1.0, 0.0)), (tags.indices[~lid], (0.0, 0.0))],
                     time_order=1)
    seconds = march(air, TAYLOR_HOOD_STEP, round(end_time / TAYLOR_HOOD_STEP))
    return compared(4 * n * n, seconds, air.at_points)


def cavity_of_ico_foam(n, folder, end_time):
    """Cells, seconds and deviations of icoFoam, linear between cell centres and walls."""
    patches = {"lid": ("wall", "", "y+", "type fixedValue; value uniform (1 0 0);", "type zeroGradient;"),
               "walls": ("wall", "", "x- x+ y-", "type noSlip;", "type zeroGradient;"),
               "faces": ("empty", "", "z- z+", "type empty;", "type empty;")}
    steps = int(np.ceil(end_time * n / ICO_FOAM_COURANT))
    ico_foam.write_case(folder, (1, 1, 1 / n), (n, n, 1), patches, CAVITY_VISCOSITY, end_time / steps, steps)
    seconds = ico_foam.run(folder)
    at, u = np.r_[0, (np.arange(n) + 0.5) / n, 1], np.zeros((n + 2, n + 2, 2))
    u[1:-1, 1:-1], u[-1, :, 0] = ico_foam.final_velocity(folder, n * n).reshape(n, n, 2), 1.0
    return compared(n * n, max(float(seconds[-1] - seconds[0]), TICK),
                    lambda x: RegularGridInterpolator((at, at), u)(x[:, 1::-1]))
