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


def jet():
    """A jet into a box of air, near a wall of which particles are."""
    mesh, tags = fe_el.box((0.2, 0.1, 0.1), (20, 10, 10))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.2, 1.8e-5)
    air.set_pressure(tuple(range(1, 7)))
    p = fe_el.Particles(mesh, 1000.0)
    p.remove_at(tags, tuple(range(1, 7)))
    source = fe_el.DiscSource((0.03, 0.05, 0.05), (1, 0, 0), 0.02)
    injector = fe_el.Injector(p, source, (3.0, 0, 0), 1e-3, number_rate=2e4, seed=1)
    coupling = fe_el.Coupling.of(air, p, [fe_el.Drag("beetstra"), fe_el.PressureGradient()],
                                 smoothing=fe_el.HelmholtzSmoothing(mesh, 3e-3))
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
