"""Forces as an open list: a user's own ones conserve momentum like drag, and see the fluid that is there."""
import inspect

import numpy as np
import pytest

import fe_el

D, RHO_P, RHO, MU = 150e-6, 1500.0, 1.3, 1.8e-5


class OwnLift:
    """Saffman's lift of a sphere at low Reynolds numbers, as a script has it."""

    needs = ("slip", "vorticity")

    def force(self, fluid):
        """1.615 d^2 sqrt(mu rho / |curl u|) slip x curl u [N]."""
        size = np.linalg.norm(fluid.vorticity, axis=1) + 1e-30
        strength = 1.615 * fluid.particles.diameter ** 2 * np.sqrt(fluid.viscosity * fluid.density / size)
        return strength[:, None] * np.cross(fluid.slip, fluid.vorticity)


class OwnDrag:
    """Stokes drag in a suspension."""

    needs = ("solid_fraction",)

    def drag_coefficient(self, fluid):
        """18 mu (1 - s) / d^2 [kg/(m^3 s)]."""
        return 18 * fluid.viscosity * (1 - fluid.solid_fraction) / fluid.particles.diameter ** 2


def suspension(forces, smoothing=None, seed=1, **kwargs):
    """Beads of random velocity in a turning gas, periodic, without gravity."""
    mesh, _ = fe_el.periodic_box((2e-3,) * 3, (4, 4, 4))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, RHO, MU, tolerance=1e-12)
    k = 2 * np.pi / 2e-3
    air.set_initial_velocity(lambda t, x: np.column_stack([np.sin(k * x[:, 1]), np.sin(k * x[:, 2]), np.sin(k * x[:, 0])]))
    beads = fe_el.Particles(mesh, RHO_P)
    beads.insert_in_box((0, 0, 0), (2e-3,) * 3, 300, D, seed=seed)
    beads.velocity[:] = np.random.default_rng(2).normal(size=(300, 3))[beads.id]
    coupling = fe_el.Coupling(beads, air.velocity, air.pressure, RHO, MU, forces,
                              smoothing=smoothing and fe_el.HelmholtzSmoothing(mesh, smoothing), **kwargs)
    return air, beads, coupling


def step(air, beads, coupling, dt):
    coupling.to_fluid(dt)
    air.advance(dt, coupling.fields)
    coupling.to_particles(dt)
    beads.advance(dt)


def test_own_lift_is_a_short_script():
    source = inspect.getsource(OwnLift)
    assert len(source.splitlines()) <= 25 and "_" not in source.replace("drag_coefficient", "").replace("__", "")


@pytest.mark.ranks
@pytest.mark.parametrize("smoothing", [None, 3e-4])
@pytest.mark.parametrize("forces", [[OwnLift()], [OwnLift(), fe_el.Drag("beetstra")],
                                    [OwnDrag(), OwnLift(), fe_el.ViscousStress()]])
def test_own_forces_conserve_momentum(forces, smoothing):
    """Fluid and particles exchange it to round-off, step by step, and keep their sum."""
    air, beads, coupling = suspension([*forces, fe_el.PressureGradient()], smoothing)
    coupling.to_fluid(1e-4)
    size = beads.comm.allreduce((beads.mass[:, None] * np.abs(beads.velocity)).sum(0))
    air.void_fraction = coupling.fields[0].x.array[:air.num_cells].copy()
    before, speeds = air.momentum() + beads.momentum(), beads.velocity.copy()
    for _ in range(4):
        step(air, beads, coupling, 1e-4)
        assert coupling.momentum_imbalance < 1e-12
        assert np.abs(beads.force).max(initial=1.0) > 0
    assert np.abs(air.momentum() + beads.momentum() - before).max() < 1e-12 * size.max()
    assert beads.comm.size > 1 or np.abs(beads.velocity - speeds).max() > 1e-4


@pytest.mark.ranks
def test_own_drag_is_taken_implicitly_like_the_built_in_one(by_id):
    """Steps of thirty relaxation times of the fluid: the same velocities."""
    found = []
    for force in (OwnDrag(), fe_el.Drag("stokes")):
        air, beads, coupling = suspension([force])
        for _ in range(3):
            step(air, beads, coupling, 3e-2)
        found.append(by_id(beads, beads.velocity))
    assert found[0] == pytest.approx(found[1], abs=1e-10)


@pytest.mark.ranks
@pytest.mark.parametrize("dimension", [2, 3])
def test_velocity_gradient_of_a_linear_velocity(dimension):
    """Exact in every cell, also beside boundaries."""
    class Look:
        needs = ("velocity_gradient", "vorticity", "slip", "velocity")

        def force(self, fluid):
            self.seen = fluid
            return np.zeros_like(fluid.slip)

    d, look = dimension, Look()
    mesh, _ = fe_el.box((1.0, 2.0, 1.5)[:d], (4, 5, 3)[:d])
    air, beads = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.0, 1.0), fe_el.Particles(mesh, 1000.0)
    slope = np.random.default_rng(3).normal(size=(d, d))
    air.set_initial_velocity(lambda t, x: x[:, :d] @ slope.T)
    beads.insert_in_box((0.05,) * d, (0.95,) * d, 50, 0.01, seed=1)
    fe_el.Coupling(beads, air.velocity, air.pressure, 1.0, 1.0, [look]).to_fluid(1e-3)
    assert look.seen.velocity_gradient == pytest.approx(np.broadcast_to(slope, (len(beads), d, d)), abs=1e-11)
    curl = np.zeros(3)
    curl[2] = slope[1, 0] - slope[0, 1]
    if d == 3:
        curl[:2] = slope[2, 1] - slope[1, 2], slope[0, 2] - slope[2, 0]
    assert look.seen.vorticity == pytest.approx(np.broadcast_to(curl, (len(beads), 3)), abs=1e-11)
    assert np.array_equal(look.seen.slip, look.seen.velocity)


@pytest.mark.ranks
@pytest.mark.parametrize("smoothing", [None, 3e-4])
def test_heat_that_particles_give_off_is_what_the_fluid_gets(smoothing):
    """A user's own exchange: the public maps are each other's transpose, to round-off."""
    air, beads, coupling = suspension([fe_el.Drag("stokes")], smoothing)
    message = "to_fluid"
    with pytest.raises(RuntimeError, match=message):
        coupling.to_cells(beads.volume)
    coupling.to_fluid(1e-4)
    warm = air.corner.mean(1)[:, 0] / 2e-3 + 1.0
    heat = 1e-3 * beads.diameter * (2.0 - coupling.at_particles(warm))
    volume, total = air.volume, beads.comm.allreduce(heat.sum())
    assert beads.comm.allreduce(volume @ coupling.to_cells(heat)) == pytest.approx(total, rel=1e-12)
    rows = np.column_stack([heat, beads.velocity[:, 1]])
    left = beads.comm.allreduce((volume * warm) @ coupling.to_cells(rows))
    right = beads.comm.allreduce(coupling.at_particles(warm) @ rows)
    assert left == pytest.approx(right, rel=1e-10)


@pytest.mark.ranks
def test_what_is_no_force_is_refused():
    class Needy:
        needs = ("magic",)

        def force(self, fluid):
            return 0.0

    class Wrong:
        needs = ()

        def force(self, fluid):
            return np.full((len(fluid.particles), 2), np.nan)

    class Blind:
        needs = ("slip",)

        def force(self, fluid):
            return fluid.vorticity

    with pytest.raises(ValueError, match="magic"):
        suspension([Needy()])
    with pytest.raises(ValueError, match="no force"):
        suspension([OwnLift])
    for force, error, words in ((Wrong(), ValueError, "shape"), (Blind(), AttributeError, "needs")):
        with pytest.raises(error, match=words):
            suspension([force])[2].to_fluid(1e-4)
