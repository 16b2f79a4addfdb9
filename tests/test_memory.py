"""Native memory that a step leaves behind: none, however long a run is."""
import ctypes
import gc

import numpy as np
import pytest

import fe_el
from demos.benchmarks.long_run import Scene

NAMES = ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost")
KIND = type("Mallinfo", (ctypes.Structure,), {"_fields_": [(name, ctypes.c_size_t) for name in NAMES]})
LIBRARY = ctypes.CDLL("libc.so.6")
LIBRARY.mallinfo2.restype = KIND


def used():
    """Bytes that the C library has given out."""
    gc.collect()
    now = LIBRARY.mallinfo2()
    return now.uordblks + now.hblkhd


def test_contacts_keep_no_memory_from_step_to_step():
    """A thousand steps of beads that move, renewals of the lists included."""
    mesh, tags = fe_el.box((0.02, 0.02, 0.05), (2, 2, 4))
    beads = fe_el.Particles(mesh, 2500.0, (0, 0, -9.81))
    beads.insert_on_lattice((0, 0, 0), (0.02, 0.02, 0.048), np.repeat([1.6e-3, 2.4e-3], [30, 15]), seed=3)
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(500.0, 0.9, 0.1), (tags, (1, 2, 3, 4, 5)))
    for k in range(1400):
        if k == 400:
            before = used()
        if k % 200 == 0:
            beads.gravity[:2] = 15 * np.cos(k), 15 * np.sin(k)
        beads.advance(1e-4, contacts)
    assert (used() - before) / 1000 < 60


def test_a_step_of_everything_keeps_no_memory(folder):
    """Fluid, scalar, inlet, outlet, walls of three kinds, forces, averages and a probe: numba's dispatcher alone would lose
    1200 bytes in each, where it is given long tuples."""
    scene = Scene(folder)
    for _ in range(300):
        scene.step()
    before = used()
    for _ in range(700):
        scene.step()
    assert (used() - before) / 700 < 60


def test_contacts_go_on_after_an_error_that_was_mended():
    """Springs that were no numbers in the step that failed are none in the next."""
    mesh, _ = fe_el.box((0.012, 0.012, 0.02), (3, 3, 5))
    beads = fe_el.Particles(mesh, 2500.0, (0, 0, -9.81))
    places = np.stack(np.meshgrid(*3 * [np.arange(5)], indexing="ij"), -1).reshape(-1, 3)
    beads.insert_at(0.0012 + 0.00199 * places, 2e-3)
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(500.0, 0.7, 0.5))
    for _ in range(3):
        beads.advance(1e-4, contacts)
    beads.angular_velocity[0] = np.nan
    with pytest.raises((FloatingPointError, ValueError)):
        beads.advance(1e-4, contacts)
    beads.angular_velocity[0] = 0.0
    for _ in range(5):
        beads.advance(1e-4, contacts)
    assert np.isfinite(beads.position).all() and np.isfinite(beads.angular_velocity).all()
