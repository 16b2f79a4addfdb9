"""The fluid while the void fraction moves: exact free stream, momentum, energy, and orders against a manufactured
solution."""
import numpy as np
import pytest
from dolfinx import fem

import fe_el
from fe_el.dolfinx_api import scalar_space, vector_space

PI = np.pi
VISCOSITY, STEP = 0.1, 1e-4


def fields_of(mesh):
    """Void fraction, drag coefficient and momentum source, all zero."""
    scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
    return fem.Function(scalar), fem.Function(scalar), fem.Function(vector)


def carried(air, phi, rate0, dt, stream, weight):
    """The void fraction after a step in which a uniform stream carries it along, as the scheme's continuity sees it.

    The smallest change of ``phi`` with (phi' stream, grad w) = (end rate, w) for every nodal w; weight 1.5 and 0.5 are those
    of the parabola through three void fractions, 1 and 0 those of a first-order rate.
    """
    m, n = air.dimension + 1, air.num_cells
    share, flow = np.zeros((air.nodes, n)), np.zeros((air.nodes, n))
    for i in range(m):
        np.add.at(share, (air.dofs[:, i], np.arange(n)), air.volume / m)
        np.add.at(flow, (air.dofs[:, i], np.arange(n)), air.volume * (air.gradient[:, i] @ stream))
    change = np.linalg.lstsq(flow - weight / dt * share, -flow @ phi - (weight - 1) * share @ rate0, rcond=1e-12)[0]
    return phi + change


@pytest.mark.parametrize("order", [1, 2])
def test_free_stream_stays_uniform_while_the_void_fraction_changes(order):
    """A uniform velocity stays uniform to solver tolerance in a rough void fraction that it carries along."""
    mesh, _ = fe_el.periodic_box((1.0, 1.0), (6, 6))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.3, 1e-3, tolerance=1e-13, time_order=order)
    stream, dt = np.array([0.3, -0.2]), 0.05
    air.set_initial_velocity(stream)
    void, drag, source = fields_of(mesh)
    phi, rate0, moved = np.random.default_rng(1).uniform(0.6, 0.9, air.num_cells), np.zeros(air.num_cells), 0.0
    air.void_fraction = phi
    for k in range(12):
        new = carried(air, phi, rate0, dt, stream, 1.5 if order == 2 and k >= 2 else 1.0)
        assert new.min() > 0.2
        void.x.array[:] = new
        air.advance(dt, (void, drag, source))
        moved, rate0, phi = max(moved, np.abs(new - phi).max()), (new - phi) / dt, new
        assert np.abs(air.velocity.x.array.reshape(-1, 2) - stream).max() < 1e-10
    assert moved > 0.01


def void_fraction(t, x, y):
    return 0.6 + 0.2 * np.sin(PI * x - 3 * t) * np.cos(PI * y + t)


def velocity(t, x, y):
    f = 1 + 0.5 * np.sin(2 * t)
    return f * np.array([np.sin(PI * x) ** 2 * np.sin(PI * y) * np.cos(PI * y),
                         -np.sin(PI * x) * np.cos(PI * x) * np.sin(PI * y) ** 2])


def pressure(t, x, y):
    return np.cos(t) * np.sin(PI * x) * np.sin(PI * y)


def slopes(f, t, x, y, h=STEP):
    """Derivatives of f(t, x, y) by x, y and t."""
    steps = ((0, h, 0), (0, 0, h), (h, 0, 0))
    return [(np.asarray(f(t + a, x + b, y + c)) - np.asarray(f(t - a, x - b, y - c))) / (2 * h) for a, b, c in steps]


def mass_source(t, c):
    x, y = c[:, 0] - 1, c[:, 1] - 1
    flux = [slopes(lambda t, x, y, k=k: void_fraction(t, x, y) * velocity(t, x, y)[k], t, x, y)[k] for k in (0, 1)]
    return slopes(void_fraction, t, x, y)[2] + sum(flux)


def body_force(t, c):
    x, y = c[:, 0] - 1, c[:, 1] - 1
    (ux, uy, ut), u, phi = slopes(velocity, t, x, y), velocity(t, x, y), void_fraction(t, x, y)
    fx, fy, _ = slopes(void_fraction, t, x, y)
    around = sum(velocity(t, x + a, y + b) for a, b in ((STEP, 0), (-STEP, 0), (0, STEP), (0, -STEP)))
    viscous = VISCOSITY * ((around - 4 * u) / STEP ** 2 + (fx * ux + fy * uy) / phi)
    return (ut + u[0] * ux + u[1] * uy + mass_source(t, c) / phi * u + np.array(slopes(pressure, t, x, y)[:2]) - viscous).T


def manufactured_error(n, dt, end=1.0):
    """Relative L2 errors of the cell velocity at the end and of the pressure, which is that of the middle of the last
    step."""
    mesh, tags = fe_el.box((2.0, 2.0), (n, n))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.0, VISCOSITY, tolerance=1e-10)
    for side in (1, 2, 3, 4):
        air.set_no_slip(side)
    air.body_force, air.mass_source = body_force, mass_source
    air.set_initial_velocity(lambda t, x: velocity(0, x[:, 0] - 1, x[:, 1] - 1).T)
    fields, x = fields_of(mesh), air.corner.mean(1) - 1
    air.void_fraction = void_fraction(0.0, x[:, 0], x[:, 1])
    for k in range(round(end / dt)):
        fields[0].x.array[:] = void_fraction((k + 1) * dt, x[:, 0], x[:, 1])
        air.advance(dt, fields)
    u, p = velocity(end, x[:, 0], x[:, 1]).T, pressure(end - 0.5 * dt, x[:, 0], x[:, 1])
    off = air.pressure.x.array[air.dofs].mean(1) - p
    off -= air.volume @ off / air.volume.sum()
    error = air.volume @ ((air.velocity.x.array.reshape(-1, 2) - u) ** 2).sum(1)
    return np.sqrt(error / (air.volume @ (u ** 2).sum(1))), np.sqrt(air.volume @ off ** 2 / (air.volume @ p ** 2))


def test_manufactured_solution_with_a_moving_void_fraction():
    """Second order in velocity when mesh and step are refined together."""
    errors = np.array([manufactured_error(n, 0.4 / n) for n in (16, 32)])
    orders = np.log2(errors[0] / errors[1])
    assert orders[0] > 1.9 and orders[1] > 1.4 and errors[1, 0] < 0.012
