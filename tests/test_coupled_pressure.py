"""The pressure of a long viscous step among drag: momentum and mass exact whatever is left, the same on any ranks."""
import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import fe_el
from fe_el.dolfinx_api import scalar_space, vector_space
from fe_el.fluid import coupled_pressure
from fe_el.nodes.flexible_gmres import flexible_gmres

pytestmark = pytest.mark.ranks


def among_drag(d, ends, comm=MPI.COMM_WORLD, steps=3, number=30.0, strength=1e4, tolerance=1e-9):
    """Fluid among bodies that move up and down in a periodic box, or are at rest in a duct that it enters with speed 1.

    Returns fluid, momentum before the last step, what drag and sources gave in it, and the size of what both gave."""
    n = 8 if d == 2 else 4
    make = fe_el.periodic_box if ends == "periodic" else fe_el.box
    mesh, tags = make((1.0,) * d, (n,) * d, comm=comm)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags if ends == "duct" else None, 1.0, 1.0, tolerance=tolerance)
    if ends == "duct":
        air.set_no_slip(tuple(range(1, 2 * d - 1)))
        air.set_velocity(2 * d - 1, (0.0,) * (d - 1) + (1.0,))
        air.set_pressure(2 * d, 5.0)
    scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
    void, drag, source = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
    void.x.array[:], dt, own, (x, y) = 1.0, number / n ** 2, air.num_cells, air.corner.mean(1)[:, [0, d - 1]].T
    for step in range(steps):
        drag.x.array[:own] = strength * (np.sin(40 * x + 3 * step) * np.cos(10 * y) > 0.3)
        drag.x.scatter_forward()
        source.x.array[d - 1:d * own:d] = drag.x.array[:own] * np.sin(6 * x) * (ends == "periodic")
        before = air.momentum()
        air.advance(dt, (void, drag, source))
    q = air.velocity.x.array.reshape(-1, d)[:own]
    given = dt * air.volume @ (source.x.array.reshape(-1, d)[:own] - drag.x.array[:own, None] * q)
    whole = dt * (air.volume * drag.x.array[:own]).sum()
    return air, before, comm.allreduce(given), comm.allreduce(whole)


@pytest.mark.parametrize("enough", [0.01, 0.05, 0.5])
@pytest.mark.parametrize("d", [2, 3])
def test_momentum_and_mass_are_exact_whatever_is_left_of_the_divergence(d, enough, monkeypatch):
    monkeypatch.setattr(coupled_pressure, "FITS", enough)
    monkeypatch.setattr(coupled_pressure, "ENOUGH", enough)
    air, before, given, whole = among_drag(d, "periodic", steps=1, tolerance=1e-12)
    assert air.momentum() == pytest.approx(before + given, abs=1e-14 * whole)
    assert air.mass_residual() < 1e-10 and (air.last_step.pressure_iterations > 0 or enough > 0.01)


@pytest.mark.parametrize("ends", ["periodic", "duct"])
@pytest.mark.parametrize("d", [2, 3])
def test_any_number_of_ranks_gives_the_same_flow(d, ends):
    """Whatever is left of the divergence."""
    powers = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        air = among_drag(d, ends, comm, 3, strength=100.0, tolerance=1e-12)[0]
        q = air.velocity.x.array.reshape(-1, d)[:air.num_cells]
        powers.append(comm.allreduce(air.volume @ q ** 2))
        assert air.last_step.pressure_iterations > 0
    assert powers[0] == pytest.approx(powers[1], rel=1e-9, abs=1e-12)


def test_fluid_at_rest_under_gravity_among_drag_asks_for_no_iteration_after_the_first_step():
    mesh, tags = fe_el.box((1.0, 1.0), (6, 6))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1000.0, 1.0, gravity=(0.0, -9.81), tolerance=1e-12)
    air.set_no_slip((1, 2, 3, 4))
    scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
    void, drag, source = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
    void.x.array[:], found = 1.0, []
    drag.x.array[:] = 1e6 * (np.arange(len(drag.x.array)) % 3 == 0)
    for _ in range(4):
        air.advance(3000.0, (void, drag, source))
        found.append(air.last_step.pressure_iterations)
    assert found[1:] == [0, 0, 0] and np.abs(air.velocity.x.array).max() < 1e-9


def test_directions_of_any_preconditioner_add_up_to_the_solution():
    """Each one less of the residual; as many as the system has unknowns solve it."""
    rng = np.random.default_rng(1)
    matrix, residual, left = np.eye(12) + 0.3 * rng.normal(size=(12, 12)), rng.normal(size=12), []
    for most in range(1, 13):
        weights, directions = flexible_gmres(lambda z: matrix @ z, lambda r: rng.uniform(0.5, 2.0, 12) * r, residual, np.dot,
                                             most, 1e-12)
        left.append(np.linalg.norm(residual - matrix @ sum(w * z for w, z in zip(weights, directions))))
    assert len(directions) == 12 and left[-1] < 1e-9 and left[5] < 0.5 * np.linalg.norm(residual)
    assert [len(part) for part in flexible_gmres(None, None, np.zeros(3), np.dot, 4, 0.1)] == [0, 0]
