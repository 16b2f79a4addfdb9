"""Meshes cut so that every rank has as much work with cells and particles: even parts, and the same results."""
import numpy as np
import pytest
from mpi4py import MPI

import fe_el
from fe_el.mesh.partition import PARTICLE_WORK, owners

D, SIZE = 1e-3, (0.01, 0.01, 0.04)


def cubes(shape):
    """Middles of the unit cubes of a box."""
    return np.stack(np.meshgrid(*[np.arange(n) + 0.5 for n in shape], indexing="ij"), -1).reshape(-1, len(shape))


@pytest.mark.parametrize("ranks", [1, 2, 3, 4, 7, 16])
@pytest.mark.parametrize("axis", [None, 0, 2])
def test_parts_have_as_much_work(ranks, axis):
    """To a cell and its particles at each cut; slices follow each other, and no rank is without cells."""
    x = cubes((12, 8, 40))
    number = np.where(x[:, 2] < 10, 4.0, 0.0) * (1 + (x[:, 0] > 6))
    owner = owners(x, number, ranks, axis)
    work = np.bincount(owner, 1 + PARTICLE_WORK * number, minlength=ranks)
    assert work.max() <= work.mean() + np.ceil(np.log2(ranks)) * (1 + 80) and np.bincount(owner, minlength=ranks).min() > 0
    if axis is not None:
        order = np.argsort(x[:, axis], kind="stable")
        assert (np.diff(owner[order]) >= 0).all()


def test_a_full_corner_of_few_cells_leaves_every_rank_a_cell():
    x = cubes((3, 3))
    owner = owners(x, np.where(np.arange(9) == 0, 1e6, 0.0), 9)
    assert sorted(owner) == list(range(9))


def test_cells_and_particles_are_both_even_where_they_can_be():
    """A column whose lowest quarter is full is cut upright, although it is longest along z; an even one across z."""
    x = cubes((8, 8, 40))
    full = owners(x, np.where(x[:, 2] < 10, 5.0, 0.0), 4)
    assert np.bincount(full).tolist() == [640] * 4 and np.bincount(full[x[:, 2] < 10]).tolist() == [160] * 4
    even = owners(x, np.zeros(len(x)), 4)
    assert [np.ptp(x[even == r, 2]) for r in range(4)] == [9.0] * 4


def places():
    """Of beads on the floor of a column, on one side of it more than on the other."""
    x = np.random.default_rng(2).random((4000, 3)) * (0.009, 0.009, 0.009) + 5e-4
    keep = [x[0]]
    for one in x:
        if len(keep) < 180 and (np.linalg.norm(np.array(keep) - one, axis=1) > D).all() and one[0] < 0.006 + 0.3 * one[2]:
            keep.append(one)
    return np.array(keep)


def column(kind, balance, comm=MPI.COMM_WORLD):
    """Beads in gas, in a box or a periodic one, on a mesh that is balanced or not."""
    if kind == "periodic":
        mesh, tags = fe_el.periodic_box(SIZE, (3, 3, 12), (True, False, False), comm, balance=balance)
    else:
        mesh, tags = fe_el.box(SIZE, (3, 3, 12), comm, slices_along=0 if kind == "slices" else None, balance=balance)
    beads = fe_el.Particles(mesh, 2500.0, (0, 0, -9.81))
    walls = (3, 4, 5) if kind == "periodic" else (1, 2, 3, 4, 5)
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(500.0, 0.9, 0.3), (tags, walls), steps_per_contact=15)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.2, 1.8e-5, tolerance=1e-12)
    air.set_velocity(5, (0, 0, 0.9))
    air.set_pressure(6)
    coupling = fe_el.Coupling.of(air, beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient()])
    return beads, contacts, air, coupling


def advance(scene, steps):
    beads, contacts, air, coupling = scene
    for _ in range(steps):
        coupling.to_fluid(2e-4)
        air.advance(2e-4, coupling.fields)
        coupling.to_particles(2e-4)
        beads.advance(2e-4, contacts)


@pytest.mark.ranks
@pytest.mark.parametrize("kind", ["box", "slices", "periodic"])
def test_a_balanced_run_is_the_run_that_is_not(kind, by_id):
    """Places by number after 40 steps; ranks have as many particles but for those of some layers of cells."""
    x = places()
    ends = []
    for balance in (None, x):
        scene = column(kind, balance)
        scene[0].insert_at(x, D)
        if balance is not None:
            even = scene[0].imbalance()
            assert even["particles_imbalance"] < 1.3 and even["work_imbalance"] < 1.25
        advance(scene, 40)
        ends.append(by_id(scene[0], scene[0].position))
    assert np.abs(ends[0] - ends[1]).max() < 1e-10


@pytest.mark.ranks
def test_a_run_goes_on_from_a_checkpoint_on_a_mesh_cut_by_its_particles(folder, by_id):
    scene = column("box", None)
    scene[0].insert_at(places(), D)
    advance(scene, 10)
    fe_el.save_checkpoint(folder + "/a.h5", *scene)
    again = column("box", folder + "/a.h5")
    fe_el.load_checkpoint(folder + "/a.h5", *again)
    assert again[0].imbalance()["work_imbalance"] < 1.25
    for run in (scene, again):
        advance(run, 20)
    assert np.abs(by_id(scene[0], scene[0].position) - by_id(again[0], again[0].position)).max() < 1e-10
    assert again[0].step == 30


@pytest.mark.ranks
def test_meshes_of_gmsh_and_in_two_dimensions_are_balanced():
    """Particles at the mouth of a hopper, and in a corner of a sheet."""
    rng = np.random.default_rng(1)
    x = rng.random((500, 3)) * (0.02, 0.01, 0.02) + (0.04, 0.0025, 0.005)
    mesh, _, tags = fe_el.mesh_geo("meshes/hopper.geo", size=0.01, balance=x)
    beads = fe_el.Particles(mesh, 2500.0)
    inside = beads.comm.allreduce((beads.search(x) >= 0).astype(int)) > 0
    beads.insert_at(x[inside], 1e-4)
    assert inside.sum() > 200 and len(tags.values) > 0 and beads.imbalance()["particles_imbalance"] < 1.5
    mesh, _ = fe_el.box((1.0, 1.0), (20, 20), balance=0.2 * x[:, :2] / x.max(0)[:2])
    beads = fe_el.Particles(mesh, 2500.0)
    beads.insert_at(0.2 * x[:, :2] / x.max(0)[:2], 1e-4)
    assert beads.imbalance()["work_imbalance"] < 1.5


@pytest.mark.ranks
def test_imbalance_is_said_once_and_again_when_it_has_grown(capfd):
    """At the first step by all means on several ranks; on one nothing."""
    mesh, _ = fe_el.box((1.0, 0.1, 0.1), (16, 1, 1), slices_along=0)
    beads = fe_el.Particles(mesh, 2500.0)
    beads.insert_at(np.linspace((0.01, 0.05, 0.05), (0.99, 0.05, 0.05), 96), 1e-3)
    size = beads.comm.size
    assert beads.imbalance()["particles_imbalance"] < 1.1 and beads.imbalance()["cells_imbalance"] < 1.1
    beads.advance(1e-9)
    beads.position[:, 0] *= 0.1
    beads.locate()
    for step in (999, 1999, 2000):
        beads.step = step
        beads.advance(1e-9)
    said = "".join(beads.comm.allgather(capfd.readouterr().err))
    assert said.count("ranks, step 1:") == said.count("step 1000:") == (size > 1) and said.count("balance=") == (size > 1)
    assert "step 2000" not in said and beads.imbalance()["particles_imbalance"] == pytest.approx(size)


@pytest.mark.ranks
def test_what_is_no_place_is_refused(folder):
    for balance, said in ((3.0, "places of particles"), ([[np.nan, 0, 0]], "places of particles"), ([], "places of"),
                          ("text", "There is no checkpoint text"), (object(), "places of particles")):
        with pytest.raises((ValueError, FileNotFoundError), match=said):
            fe_el.box((1.0, 1.0, 1.0), (2, 2, 2), balance=balance)
    mesh, _ = fe_el.box((1.0, 1.0), (4, 4))
    fe_el.save_checkpoint(folder + "/a.h5", fe_el.VolumeAveragedNavierStokes(mesh))
    with pytest.raises(ValueError, match="holds no particles"):
        fe_el.box((1.0, 1.0), (4, 4), balance=folder + "/a.h5")
