"""The energy of an unforced fluid never grows, far outside the ordinary range (demos/benchmarks/stability_map.py: all)."""
import numpy as np
import pytest

from demos.benchmarks.stability_scenes import Scene, least_angle

STEPS, ROUGH, SMOOTH = 200, 0.3, 0.0


def energies(scene):
    """Kinetic energy after each step over that of the start."""
    start, out = scene.energy(), [1.0]
    for _ in range(STEPS):
        scene.advance()
        out.append(scene.energy() / start)
    assert scene.fallbacks() == 0
    return np.array(out)


@pytest.mark.parametrize("roughness", [ROUGH, SMOOTH])
@pytest.mark.parametrize("changes", [
    {"reynolds": 1e7}, {"reynolds": 1e7, "drag_number": 1e8}, {"reynolds": 1e7, "void": 0.36},
                                     {"density": 1e-3, "drag": 1e3},
    {"reynolds": 1e7, "stretch": 100.0}, {"reynolds": 1e7, "drag_number": 1e8, "void": 0.36},
], ids=["Re 1e7", "drag", "void", "density", "stretch", "drag and void"])
def test_energy_decays_at_every_step(changes, roughness):
    """No step adds energy beyond the solver's tolerance, where neighbours differ by all of the drag and void fraction."""
    e = energies(Scene(16, roughness=roughness, **changes))
    assert (np.diff(e) <= 1e-8 * e[:-1]).all()


@pytest.mark.parametrize("roughness", [ROUGH, SMOOTH])
def test_energy_decays_on_slivers(roughness):
    """Half of the squares have a triangle with angles of 0.1 degrees; its Courant number is 12."""
    scene = Scene(16, roughness=roughness, angle=0.1, reynolds=1e6)
    assert 0.09 < least_angle(scene.air) < 0.11
    e = energies(scene)
    assert (np.diff(e) <= 1e-8 * e[:-1]).all()


@pytest.mark.parametrize("courant", [2.0, 3.0, 5.0])
def test_first_order_never_exceeds_the_start_at_large_courant_numbers(courant):
    """A vortex without viscosity; single steps may rise."""
    assert energies(Scene(16, 1, SMOOTH, reynolds=1e7, courant=courant)).max() <= 1 + 1e-8
