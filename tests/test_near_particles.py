"""Smoothing near particles only: what the whole smoothing gives, and its symmetries to round-off."""
import numpy as np
import pytest

import fe_el


def corner_of(mesh, share):
    """Mask of the owned cells in a corner of the unit box."""
    from fe_el.mesh.cell_mesh import owned_corners
    return (owned_corners(mesh)[0].mean(1)[:, :mesh.topology.dim] < share).all(1)


MESHES = {"squares": lambda: fe_el.box((1.0, 1.0), (40, 40))[0],
          "cubes": lambda: fe_el.box((1.0, 1.0, 1.0), (12, 12, 12))[0],
          "periodic": lambda: fe_el.periodic_box((1.0, 1.0, 1.0), (12, 12, 12))[0],
          "coarse": lambda: fe_el.box((1.0, 1.0), (6, 6))[0]}


@pytest.mark.ranks
@pytest.mark.parametrize("name, length", [("squares", 0.03), ("cubes", 0.04), ("periodic", 0.005), ("coarse", 0.01)])
def test_near_particles_smoothing_is_the_whole_one_and_its_symmetries_hold(name, length):
    """Values within the tolerance; integrals, constants and the transpose to round-off, whatever the tolerance."""
    mesh = MESHES[name]()
    for tolerance in (1e-6, 1e-2):
        smooth = fe_el.HelmholtzSmoothing(mesh, length, tolerance)
        filled, volume, total = corner_of(mesh, 0.15), smooth.nodes.volume, mesh.comm.allreduce
        near = smooth.near(filled)
        assert not near.whole
        rng = np.random.default_rng(mesh.comm.rank)
        given, felt = rng.normal(1.0, 0.5, (len(volume), 5)) * filled[:, None], rng.normal(size=(len(volume), 5))
        spread, back = near.spread(given), near.back(felt)
        one, other = total((volume[:, None] * spread * felt).sum()), total((volume[:, None] * given * back).sum())
        assert one == pytest.approx(other, rel=1e-12)
        assert np.allclose(total(volume @ spread), total(volume @ given), rtol=1e-13)
        assert np.allclose(near.back(np.full((len(volume), 9), 3.0))[filled], 3.0, rtol=1e-13)
        whole = smooth(given)
        assert total((volume @ (spread - whole) ** 2).sum()) < (3 * tolerance) ** 2 * total((volume @ whole ** 2).sum())
        wrong = (back - smooth(felt))[filled]
        assert total((wrong ** 2).sum()) < (3 * tolerance) ** 2 * total((felt[filled] ** 2).sum())


@pytest.mark.ranks
def test_cells_are_collected_and_given_up():
    """A step whose particles are in served cells changes nothing; others add to them; after a while only those of now
    count; and where most of the mesh is reached, the whole is smoothed."""
    mesh = MESHES["squares"]()
    smooth = fe_el.HelmholtzSmoothing(mesh, 0.03)
    small, large, everywhere = (corner_of(mesh, share) for share in (0.1, 0.15, 2.0))
    near = smooth.near(large)
    assert smooth.near(small, near) is near
    more = smooth.near(np.where(corner_of(mesh, 0.4), ~large, False), near)
    assert more is not near and np.array_equal(more.mask, corner_of(mesh, 0.4))
    for _ in range(100):
        more = smooth.near(small, more)
    assert np.array_equal(more.mask, small)
    whole = smooth.near(everywhere, more)
    assert whole.whole and smooth.near(small, whole) is whole
    field = np.random.default_rng(0).normal(size=(len(small), 2))
    assert np.array_equal(whole.back(field), smooth(field)) and np.array_equal(whole.spread(field), smooth(field))


def test_nothing_comes_of_no_particles():
    smooth = fe_el.HelmholtzSmoothing(MESHES["squares"](), 0.03)
    near = smooth.near(np.zeros(len(smooth.nodes.volume), bool))
    assert not near.spread(np.zeros((len(smooth.nodes.volume), 2))).any()


def jet(fluid_velocity="cell"):
    """A jet into a box of air, near a wall of which particles are."""
    mesh, tags = fe_el.box((0.2, 0.1, 0.1), (20, 10, 10))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.2, 1.8e-5)
    air.set_pressure(tuple(range(1, 7)))
    p = fe_el.Particles(mesh, 1000.0)
    p.remove_at(tags, tuple(range(1, 7)))
    source = fe_el.DiscSource((0.03, 0.05, 0.05), (1, 0, 0), 0.02)
    injector = fe_el.Injector(p, source, (3.0, 0, 0), 1e-3, number_rate=2e4, seed=1)
    coupling = fe_el.Coupling.of(air, p, [fe_el.Drag("beetstra"), fe_el.PressureGradient()],
                                 smoothing=fe_el.HelmholtzSmoothing(mesh, 3e-3), fluid_velocity=fluid_velocity)
    return air, p, injector, coupling


def advance(air, p, injector, coupling, dt=1e-3):
    injector.advance(dt)
    coupling.to_fluid(dt)
    air.advance(dt, coupling.fields)
    coupling.to_particles(dt)
    p.advance(dt)


@pytest.mark.ranks
def test_momentum_and_solids_are_exact_near_particles():
    air, p, injector, coupling = jet()
    near = set()
    for _ in range(12):
        advance(air, p, injector, coupling)
        assert coupling.momentum_imbalance < 1e-12 and coupling.solid_volume_error < 1e-12
        near.add(coupling.near)
    assert not coupling.near.whole and 1 < len(near) < 12


@pytest.mark.ranks
def test_a_run_goes_on_from_a_checkpoint_as_it_was(tmp_path):
    scene, again = jet(), jet()
    path = scene[1].comm.bcast(str(tmp_path / "jet.h5"))
    for _ in range(4):
        advance(*scene)
    fe_el.save_checkpoint(path, scene[1], scene[0], scene[2], scene[3], time=0.004)
    for _ in range(4):
        advance(*scene)
    fe_el.load_checkpoint(path, again[1], again[0], again[2], again[3])
    for _ in range(4):
        advance(*again)
    one, other = (np.concatenate(p.comm.allgather(np.column_stack([p.id, p.position]))) for p in (scene[1], again[1]))
    assert np.allclose(one[np.argsort(one[:, 0])], other[np.argsort(other[:, 0])], rtol=0, atol=1e-14)


def test_a_checkpoint_read_into_an_interpolated_velocity_keeps_all_solids(tmp_path):
    """That is smoothed on the whole mesh."""
    scene, again = jet(), jet("linear")
    for _ in range(4):
        advance(*scene)
    fe_el.save_checkpoint(tmp_path / "jet.h5", scene[1], scene[0], scene[2], scene[3], time=0.004)
    fe_el.load_checkpoint(tmp_path / "jet.h5", again[1], again[0], again[2], again[3])
    for _ in range(8):
        advance(*again)
    assert again[3].solid_volume_error < 1e-12 and again[3].momentum_imbalance < 1e-12


@pytest.mark.parametrize("whole", [False, True])
def test_a_bed_gives_no_solids_of_either_sign_beyond_itself(whole):
    """A deep bed in a column of distorted cells: what the polynomial loses of it stays in it, not at its surface."""
    h = 0.1
    mesh, _ = fe_el.box((0.4, 0.4, 8.0), (4, 4, 80))
    z = mesh.geometry.x[:, 2]
    inner = (z > 1e-9) & (z < 8.0 - 1e-9)
    z[inner] += np.random.default_rng(0).uniform(-0.15, 0.15, inner.sum()) * h
    smooth = fe_el.HelmholtzSmoothing(mesh, h)
    height = smooth.nodes.corner.mean(1)[:, 2:]
    bed = np.where(height < 3.6, 0.6, 0.0)
    near = smooth.near(bed[:, 0] > 0)
    found, fine = smooth(bed) if whole else near.spread(bed), fe_el.HelmholtzSmoothing(mesh, h, 1e-8)(bed)
    assert not near.whole and found.min() > -2e-4 and np.abs(found - fine).max() < 2e-3
    assert np.abs(found[height[:, 0] > 6.0]).max() < 2e-4


def test_drag_of_a_held_bed_in_long_steps_stays_in_it():
    """A step of 170 relaxation times: false drag of a negative sign above the bed would drive the gas without bound."""
    mesh, tags = fe_el.box((0.012, 0.012, 0.24), (4, 4, 80))
    z = mesh.geometry.x[:, 2]
    inner = (z > 1e-9) & (z < 0.24 - 1e-9)
    z[inner] += np.random.default_rng(0).uniform(-0.15, 0.15, inner.sum()) * 3e-3
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.2, 1.8e-5)
    air.set_velocity(5, (0, 0, 0.2))
    air.set_pressure(6, 0.0)
    air.set_initial_velocity((0, 0, 0.2))
    beads = fe_el.Particles(mesh, 2500.0)
    beads.insert_at(np.stack(np.meshgrid(*[(np.arange(n) + 0.5) * 1e-3 for n in (12, 12, 108)], indexing="ij"), -1)
                    .reshape(-1, 3), 1e-3)
    beads.hold()
    forces = [fe_el.Drag("ergun"), fe_el.PressureGradient()]
    coupling = fe_el.Coupling(beads, air.velocity, air.pressure, 1.2, 1.8e-5, forces,
                              smoothing=fe_el.HelmholtzSmoothing(mesh, 3e-3))
    for _ in range(10):
        coupling.to_fluid(0.05)
        air.advance(0.05, coupling.fields)
        coupling.to_particles(0.05)
    assert np.abs(air.velocity.x.array).max() < 1.0 and np.ptp(air.pressure.x.array) == pytest.approx(183.0, rel=0.01)
    drag = coupling.fields[1].x.array
    assert drag.min() > -1e-6 * drag.max()
