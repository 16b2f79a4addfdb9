"""A force that acts in one cell of a viscous fluid moves it as viscosity lets it, in steps of any length."""
import numpy as np
import pytest
from dolfinx import fem

import fe_el


def mobility(number, steps, cells=6, drag_coefficient=0.0):
    """Velocity of the cell times 6 pi mu h / F in a closed box; h: edge of the cubes, ``number``: nu dt / h^2."""
    mesh, tags = fe_el.box((1.0, 1.0, 1.0), (cells,) * 3)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.0, viscosity=1.0, tolerance=1e-9)
    for side in range(1, 7):
        air.set_no_slip(side)
    scalar, vector = fem.FunctionSpace(mesh, ("DG", 0)), fem.VectorFunctionSpace(mesh, ("DG", 0))
    void, drag, source = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
    void.x.array[:] = 1.0
    one = int(np.argmin(np.abs(air.corner.mean(1) - 0.5).max(1)))
    drag.x.array[one] = drag_coefficient / air.volume[one]
    source.x.array[3 * one + 2] = 1e-6 / air.volume[one]  # without drag the force, with drag A times the velocity of the body
    for _ in range(steps):
        air.advance(number / cells ** 2, (void, drag, source))
    velocity = air.velocity.x.array[3 * one + 2]
    return 6 * np.pi / cells * velocity / (1e-6 - drag_coefficient * velocity)


def test_velocity_does_not_depend_on_the_step():
    """Between Taylor-Hood elements on the same mesh (2.3) and a cube of the cell's volume in free space (4.3)."""
    found = np.array([mobility(0.05, 250), mobility(0.5, 40), mobility(5.0, 50), mobility(50.0, 60)])
    assert found.min() > 2.3 and found.max() < 4.3 and found.max() < 1.05 * found.min()


@pytest.mark.parametrize("strength", [1.0, 100.0])
def test_body_held_by_drag_feels_the_same_velocity(strength):
    """Drag that is weak and strong against what the fluid resists."""
    assert mobility(0.05, 250, 6, strength * np.pi) == pytest.approx(mobility(0.05, 250), rel=0.01)
