"""Beds with the default mapping: in a liquid one at rest stays at rest, one that is fluidised has the drag law's void
fraction; and a gas bed does not know the axes."""
import numpy as np
import pytest

import fe_el
from fe_el.coupling.time_scales import homogeneous_slip

WATER = {"density": 996.78, "viscosity": 8.35e-4}
FORCES = [fe_el.Drag("beetstra"), fe_el.PressureGradient(), fe_el.Buoyancy()]


def settled(density, width=3, d=2.663e-3, dry_gravity=9.81, seed=3):
    """Beads that came to rest dry on the floor of a closed box, open above, in water at rest: fluid, beads, contacts,
    coupling."""
    w = width * 2.5 * d
    mesh, tags = fe_el.box((w, w, 2 * w), (width, width, 2 * width))
    fluid = fe_el.VolumeAveragedNavierStokes(mesh, tags, **WATER)
    for side in (1, 2, 3, 4, 5):
        fluid.set_slip(side)
    fluid.set_pressure(6, 0.0)
    beads = fe_el.Particles(mesh, density, gravity=(0, 0, -dry_gravity))
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(500.0, 0.5, 0.3), walls=(tags, (1, 2, 3, 4, 5, 6)))
    count = int(0.24 * 2 * w ** 3 / (np.pi / 6 * d ** 3))
    beads.insert_in_box((d / 2,) * 3, (w - d / 2, w - d / 2, 2 * w - d / 2), count, d, seed=seed, without_overlap=True)
    for k in range(120):
        beads.advance(5e-3, contacts)
        beads.velocity *= 0.9 if k < 80 else 1.0
    beads.gravity[2] = -9.81
    return fluid, beads, contacts, fe_el.Coupling(beads, fluid.velocity, fluid.pressure, *WATER.values(), FORCES)


@pytest.mark.parametrize("density, dt, end, largest, seeds", [(3586.0, 1e-3, 0.06, 1e-4, (1, 2, 3)),
                                                              (3586.0, 1e-4, 0.06, 1e-4, (1, 2, 3)),
                                                              (1029.0, 1e-4, 0.12, 2e-3, (3,))])
def test_a_bed_in_a_liquid_comes_to_rest(density, dt, end, largest, seeds):
    """Alumina and alginate, long steps and short: what jumps in the void fraction would shake them, the more the shorter.

    Of alumina the middle one of three packings: in one a bead may give way while its springs are relieved of its weight.
    """
    late = []
    for seed in seeds:
        fluid, beads, contacts, coupling = settled(density, seed=seed)
        speed = []
        for _ in range(round(end / dt)):
            coupling.to_fluid(dt)
            fluid.advance(dt, coupling.fields)
            coupling.to_particles(dt)
            beads.advance(dt, contacts)
            speed.append(np.sqrt((beads.velocity ** 2).sum(1).mean()))
        late.append(np.sqrt(np.mean(np.square(speed[-len(speed) // 6:]))))
        assert speed[-1] < 0.6 * max(speed)
    assert np.median(late) < largest


@pytest.mark.parametrize("dt", [1e-3, 1e-4])
def test_a_bed_that_carries_its_weight_in_the_liquid_stays_at_rest(dt):
    """What moves a bed that came to rest dry is its springs, which water relieves of part of the weight, and their way back
    through the water between the beads; without that nothing moves."""
    fluid, beads, contacts, coupling = settled(3586.0, dry_gravity=9.81 * (1 - WATER["density"] / 3586.0))
    for _ in range(round(0.02 / dt)):
        coupling.to_fluid(dt)
        fluid.advance(dt, coupling.fields)
        coupling.to_particles(dt)
        beads.advance(dt, contacts)
        assert np.sqrt((beads.velocity ** 2).sum(1).mean()) < 1e-5


def test_a_bed_fluidised_by_a_liquid_has_the_void_fraction_of_the_drag_law():
    """Alumina in water at 0.1 m/s: where the slip of a uniform suspension is the superficial velocity over void fraction."""
    d, density, velocity, dt, count = 3.087e-3, 3586.0, 0.1, 2e-3, 600
    width, height = 3 * 2.5 * d, 9 * 2.5 * d
    mesh, tags = fe_el.box((width, width, height), (3, 3, 9))
    fluid = fe_el.VolumeAveragedNavierStokes(mesh, tags, **WATER)
    for side in (1, 2, 3, 4):
        fluid.set_slip(side)
    fluid.set_velocity(5, (0, 0, velocity))
    fluid.set_pressure(6, 0.0)
    beads = fe_el.Particles(mesh, density, gravity=(0, 0, -9.81))
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(500.0, 0.5, 0.1), walls=(tags, (1, 2, 3, 4, 5, 6)),
                              steps_per_contact=20)
    top = count * np.pi / 6 * d ** 3 / 0.3 / width ** 2
    beads.insert_in_box((d / 2,) * 3, (width - d / 2, width - d / 2, top), count, d, seed=1, without_overlap=True)
    coupling = fe_el.Coupling(beads, fluid.velocity, fluid.pressure, *WATER.values(), FORCES)
    z, volume, void_fractions = beads.cells.corner.mean(1)[:, 2], beads.cells.volume, []
    for _ in range(round(1.5 / dt)):
        coupling.to_fluid(dt)
        fluid.advance(dt, coupling.fields)
        coupling.to_particles(dt)
        beads.advance(dt, contacts)
        height = 2 * beads.position[:, 2].mean()
        middle = (z > 0.25 * height) & (z < 0.7 * height)
        void_fractions.append(np.average(coupling.fields[0].x.array[middle], weights=volume[middle]))
    low, high = 0.3, 0.9
    for _ in range(50):
        phi = 0.5 * (low + high)
        slip = homogeneous_slip(d, density, *WATER.values(), 1 - phi, fe_el.drag_laws.beetstra)
        low, high = (phi, high) if phi * slip < velocity else (low, phi)
    assert phi == pytest.approx(0.556, abs=5e-4)
    assert np.mean(void_fractions[len(void_fractions) // 2:]) == pytest.approx(phi, abs=0.015)


def pressures(turn, steps=100):
    """Largest pressure in every step of a gas bed in a box that stands along the columns of ``turn``."""
    mesh, tags = fe_el.box((0.01, 0.01, 0.03), (3, 3, 9))
    mesh.geometry.x[:] = mesh.geometry.x @ turn.T
    up, d, dt = turn @ [0, 0, 1.0], 1e-3, 2e-4
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.2, viscosity=1.8e-5)
    air.set_velocity(5, 0.6 * up)
    air.set_pressure(6, 0.0)
    for side in (1, 2, 3, 4):
        air.set_slip(side)
    beads = fe_el.Particles(mesh, density=2500.0, gravity=-9.81 * up)
    x = fe_el.particles.insertion.lattice_positions((2e-4, 2e-4, 1e-4), (0.0098, 0.0098, 0.02), np.full(800, d), 1)
    beads.insert_at(x @ turn.T, d)
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(500.0, 0.9, 0.1), walls=(tags, (1, 2, 3, 4, 5, 6)))
    coupling = fe_el.Coupling(beads, air.velocity, air.pressure, 1.2, 1.8e-5, FORCES[:2])
    largest = []
    for _ in range(steps):
        coupling.to_fluid(dt)
        air.advance(dt, coupling.fields)
        coupling.to_particles(dt)
        beads.advance(dt, contacts)
        largest.append(air.pressure.x.array.max())
    return np.array(largest)


def test_a_gas_bed_does_not_know_the_axes():
    turn = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    plain, turned = pressures(np.eye(3)), pressures(turn)
    assert np.abs(turned / plain - 1).max() < 0.01
