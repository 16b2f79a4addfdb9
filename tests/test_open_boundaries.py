"""Inlets, outlets and what happens to a run that fails."""
import json
import time
from pathlib import Path

import meshio
import numpy as np
import pytest

import fe_el

RHO, D = 2500.0, 2e-3
LAW = fe_el.LinearSpringDashpot(1000.0, 0.7, 0.3)


@pytest.mark.ranks
def test_inlet_keeps_its_mass_rate_and_outlet_counts_what_leaves():
    """Beads rain from the top through the bottom: what came in is in the box, has left, or waits; none overlap."""
    mesh, tags = fe_el.box((0.03, 0.03, 0.06), (3, 3, 6))
    p = fe_el.Particles(mesh, RHO, (0, 0, -9.81))
    rate = 0.05
    inlet = fe_el.Inlet(p, tags, 6, rate, [1.5e-3, 2e-3], (0, 0, -0.5), seed=3)
    p.remove_at(tags, 5)
    contacts = fe_el.Contacts(p, LAW, (tags, (1, 2, 3, 4)))
    overlap = 0.0
    for _ in range(200):
        inlet.advance(1e-3)
        if p.total_number:
            p.advance(1e-3, contacts)
            overlap = max(overlap, contacts.largest_overlap)
    mass = p.comm.allreduce(p.mass.sum())
    assert mass + p.left_mass + inlet.waiting == pytest.approx(rate * 0.2, rel=1e-12)
    assert inlet.inserted == p.total_number + p.left and p.left > 50
    assert inlet.waiting < 3 * RHO * np.pi / 6 * D ** 3
    assert p.comm.allreduce(overlap, op=__import__("mpi4py.MPI", fromlist=["MAX"]).MAX) < 0.05


@pytest.mark.ranks
def test_what_comes_in_does_not_depend_on_ranks():
    """The same beads in the same places, whether the mesh lies on one rank or on all."""
    from mpi4py import MPI
    found = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        mesh, tags = fe_el.box((0.03, 0.03, 0.06), (3, 3, 6), comm=comm)
        p = fe_el.Particles(mesh, RHO, (0, 0, -9.81))
        inlet = fe_el.Inlet(p, tags, 6, 0.2, [1.5e-3, 2e-3], (0, 0, -0.5), seed=3)
        for _ in range(20):
            inlet.advance(1e-3)
            p.advance(1e-3)
        x = np.zeros((p.next_id, 4))
        x[p.id] = np.column_stack([p.position, p.diameter])
        found.append(comm.allreduce(x))
    assert len(found[0]) > 50 and np.abs(found[0] - found[1]).max() < 1e-12


@pytest.mark.ranks
def test_a_crowded_inlet_waits():
    """More mass than fits through the inlet is not lost: it waits, and is counted."""
    mesh, tags = fe_el.box((0.01, 0.01, 0.02), (2, 2, 4))
    p = fe_el.Particles(mesh, RHO)
    inlet = fe_el.Inlet(p, tags, 6, 1.0, lambda generator, count: generator.uniform(1.9e-3, 2e-3, count), (0, 0, -0.01),
                        tries=20)
    inlet.advance(1e-2)
    assert 5 < inlet.inserted < 25
    assert inlet.waiting + p.comm.allreduce(p.mass.sum()) == pytest.approx(1e-2, rel=1e-12)
    x = np.concatenate(p.comm.allgather(p.position))
    d = np.concatenate(p.comm.allgather(p.diameter))
    gap = np.linalg.norm(x[:, None] - x, axis=2) - 0.5 * (d[:, None] + d)
    assert gap[np.triu_indices(len(x), 1)].min() >= 0


@pytest.mark.ranks
def test_only_open_boundaries_let_particles_out():
    mesh, tags = fe_el.box((0.02, 0.02), (4, 4))
    for velocity, leaves in (((1.0, 0.0), True), ((0.0, 1.0), False)):
        p = fe_el.Particles(mesh, RHO)
        p.insert_at([[0.01, 0.011]], 1e-3, velocity=velocity)
        p.remove_at(tags, 2)
        if leaves:
            for _ in range(30):
                p.advance(1e-3)
            assert p.left == 1 and p.total_number == 0
        else:
            with pytest.raises(fe_el.LostParticle, match="outside the mesh"):
                for _ in range(30):
                    p.advance(1e-3)
    with pytest.raises(ValueError, match="group 9"):
        p.remove_at(tags, 9)


@pytest.mark.ranks
def test_springs_survive_insertion_and_removal(by_id):
    """A bead held on a slope by friction does not slip when others come and go."""
    mesh, tags = fe_el.box((0.05, 0.02, 0.02), (5, 2, 2))
    g = 9.81 * np.array([np.sin(0.2), 0, -np.cos(0.2)])
    p = fe_el.Particles(mesh, RHO, g)
    p.insert_at([[0.02, 0.01, D / 2]], D)
    law = fe_el.LinearSpringDashpot(1000.0, 0.5, 0.8, rolling=fe_el.RollingFriction(0.5, True))
    c = fe_el.Contacts(p, law, (tags, 5))
    p.remove_at(tags, 2)
    for _ in range(50):
        p.advance(1e-3, c)
    before = by_id(p, p.position)[0]
    for k in range(10):
        p.insert_at([[0.045, 0.003 + 0.001 * k, 0.01]], 1e-3, velocity=(2.0, 0, 0))
        for _ in range(5):
            p.advance(1e-3, c)
    assert p.left == 10
    assert np.abs(by_id(p, p.position)[0] - before).max() < 1e-9


@pytest.mark.ranks
def test_a_failing_run_leaves_its_last_good_state(folder):
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (2, 2, 2))
    p = fe_el.Particles(mesh, RHO)
    p.insert_at([[0.5, 0.5, 0.5]], 0.01, velocity=(1.0, 0, 0))
    out = fe_el.ParaViewOutput(folder, p, every=100.0)
    with pytest.raises(fe_el.LostParticle, match="step 6"), out:
        for time in fe_el.time_steps(0.09, 1.0, progress=False):
            p.advance(0.09)
            out.write(time)
    owner = p.comm.allgather(len(out.remembered[1][0])).index(1)
    assert np.allclose(meshio.read(f"{folder}/particles_00001_{owner}.vtu").points, [[0.95, 0.5, 0.5]])


@pytest.mark.ranks
def test_meshes_that_are_not_simplices_are_refused():
    from dolfinx import mesh as dmesh
    from mpi4py import MPI
    squares = dmesh.create_rectangle(MPI.COMM_WORLD, [[0, 0], [1, 1]], [3, 3], dmesh.CellType.quadrilateral)
    for make in (lambda: fe_el.Particles(squares, 1.0), lambda: fe_el.VolumeAveragedNavierStokes(squares)):
        with pytest.raises(ValueError, match="quadrilateral.*simplices|simplices"):
            make()
    with pytest.raises(FileNotFoundError, match="no mesh file"):
        fe_el.read_mesh("nowhere.msh")


def test_summary_has_flat_keys(folder):
    numbers = fe_el.write_summary(folder, a=np.float64(1.5), **fe_el.stage_seconds(None))
    with open(folder + "/summary.json") as file:
        assert json.load(file)["a"] == 1.5 and numbers["ranks"] >= 1
    with pytest.raises(ValueError, match="time step"):
        list(fe_el.time_steps(0.0, 1.0))


@pytest.mark.ranks
def test_after_the_summary_every_rank_can_read_what_rank_0_wrote(folder):
    """Tables that rank 0 writes late, and the summary itself; a folder that cannot be made is an error on all ranks."""
    from mpi4py import MPI
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        time.sleep(0.3)
        Path(folder, "table.csv").write_text("1\n")
    fe_el.write_summary(folder, a=comm.allreduce(1))
    assert Path(folder, "table.csv").read_text() == "1\n"
    assert json.loads(Path(folder, "summary.json").read_text())["a"] == comm.size
    with pytest.raises(OSError, match="summary cannot be written in .*table.csv"):
        fe_el.write_summary(folder + "/table.csv/below")


def test_fluid_and_particles_never_import_each_other():
    root = Path(fe_el.__file__).parent
    for folder, other in (("fluid", "particles"), ("particles", "fluid")):
        for file in (root / folder).glob("**/*.py"):
            text = file.read_text()
            assert f"fe_el.{other}" not in text and f"fe_el import {other}" not in text, file


@pytest.mark.ranks
def test_a_scene_may_start_empty():
    """The first beads come after some steps with contacts."""
    mesh, tags = fe_el.box((0.01, 0.01, 0.02), (3, 3, 6))
    beads = fe_el.Particles(mesh, 2500.0, (0, 0, -9.81))
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(500.0, 0.9, 0.3), (tags, (1, 2, 3, 4, 5)))
    inlet = fe_el.Inlet(beads, tags, 6, 1e-3, 1e-3, (0, 0, -0.1))
    for _ in range(20):
        inlet.advance(1e-4)
        beads.advance(1e-4, contacts)
    assert beads.total_number >= 1


@pytest.mark.parametrize("dimension", [2, 3])
def test_specks_that_leave_beside_the_rim_of_an_outlet_have_left(dimension):
    """Each crosses the outlet first and is below the level of the floor at the end of the step."""
    mesh, tags = fe_el.box((0.05,) * dimension, (4,) * dimension)
    dust, random, dt = fe_el.Particles(mesh, RHO), np.random.default_rng(0), 2e-3
    dust.remove_at(tags, 2)
    x = np.column_stack([0.05 - random.uniform(0, 1e-3, 4000), random.uniform(0.001, 0.049, 4000),
                         random.uniform(0, 1e-3, 4000)])
    v = np.column_stack([np.ones(4000), np.zeros(4000), -random.uniform(0, 1, 4000)])
    rim = (x[:, 2] + v[:, 2] * (0.05 - x[:, 0]) > 0) & (x[:, 2] + v[:, 2] * dt < 0)
    x, v = (np.delete(a[rim], 1, 1) if dimension == 2 else a[rim] for a in (x, v))
    dust.insert_at(x, 1e-5, velocity=v)
    dust.advance(dt)
    assert dust.left == rim.sum() > 100 and not len(dust)
    below = [(0.0499, 1e-4) if dimension == 2 else (0.0499, 0.02, 1e-4)]
    dust.insert_at(below, 1e-5, velocity=[(0.1, -1.0) if dimension == 2 else (0.1, 0, -1.0)])  # through the floor
    with pytest.raises(fe_el.LostParticle):
        dust.advance(1.05e-4)
