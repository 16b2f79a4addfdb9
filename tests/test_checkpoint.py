"""Checkpoints: a run that goes on from a file is the run without a break, on any number of ranks."""
import re
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import fe_el

DT = 2e-4


class Run:
    """Beads of two sizes with rolling friction in gas that carries a scalar; beads come in, and leave through the bottom."""

    def __init__(self, comm=MPI.COMM_WORLD, periodic=False):
        size = (0.02, 0.02, 0.03)
        if periodic:
            self.mesh, tags = fe_el.periodic_box(size, (4, 4, 6), (True, True, False), comm=comm)
        else:
            self.mesh, tags = fe_el.box(size, (4, 4, 6), comm=comm)
        down = (0, 0, -9.81)
        self.air = fe_el.VolumeAveragedNavierStokes(self.mesh, tags, 1.2, 1.8e-5, down, tolerance=1e-13)
        self.air.set_velocity(5, (0, 0, 0.6))
        self.air.set_pressure(6)
        self.beads = fe_el.Particles(self.mesh, 2500.0, down)
        law = fe_el.LinearSpringDashpot(500.0, 0.9, 0.3, rolling=fe_el.RollingFriction(0.1, True)) \
            if not periodic else fe_el.HertzMindlin(1e6, 0.3, 0.9, 0.3)
        walls = [fe_el.FacetWalls(tags, (5,) if periodic else (1, 2, 3, 4, 5)),
                 fe_el.PlaneWall((0, 0, 0.002), (0, 0, 1), velocity=(0, 0, 0.01))]
        self.contacts = fe_el.Contacts(self.beads, law, walls)
        self.coupling = fe_el.Coupling(self.beads, self.air.velocity, self.air.pressure, 1.2, 1.8e-5,
                                       [fe_el.Drag("beetstra"), fe_el.PressureGradient()])
        self.heat = fe_el.Scalar(self.air, 1e-4, lambda x: x[:, 2], "heat", 1e-13)
        self.inlet = fe_el.Inlet(self.beads, tags, 6, 0.02, [1e-3, 1.5e-3], (0, 0, -0.3), seed=4)
        self.parts = (self.beads, self.contacts, self.air, self.heat, self.inlet)

    def fill(self):
        d = np.repeat([1e-3, 2e-3], [150, 80])
        x = fe_el.particles.insertion.lattice_positions((3e-4, 3e-4, 3.1e-3), (0.0193, 0.0193, 0.02), d, 1)
        self.beads.insert_at(x, d, velocity=(0.1, 0.05, -0.3))

    def go(self, steps):
        for _ in range(steps):
            self.inlet.advance(DT)
            self.coupling.to_fluid(DT)
            self.air.advance(DT, self.coupling.fields)
            self.heat.advance(DT)
            self.coupling.to_particles(DT)
            self.beads.advance(DT, self.contacts)

    def result(self):
        """Positions and spins by number, the mean square of the cells' velocity, and the content of heat."""
        p, comm = self.beads, self.mesh.comm
        out = np.zeros((p.next_id, 6))
        out[p.id] = np.hstack([p.position, p.angular_velocity])
        q = self.air.velocity.x.array.reshape(-1, 3)[:self.air.num_cells]
        return comm.allreduce(out), comm.allreduce((self.air.volume[:, None] * q ** 2).sum(0)), self.heat.total()


@pytest.mark.ranks
@pytest.mark.parametrize("periodic", [False, True])
def test_a_run_goes_on_from_a_file_as_without_a_break(folder, periodic):
    """Saved by all ranks together, loaded by each alone: positions, spins, fluid and scalar are those of the unbroken
    run."""
    whole = Run(periodic=periodic)
    whole.fill()
    whole.go(60)
    fe_el.save_checkpoint(folder + "/state.h5", *whole.parts, time=60 * DT, name="bed")
    springs = whole.mesh.comm.allreduce(sum(len(k[0]) for k in whole.contacts.lists._collect(whole.contacts.step,
                                                                                              whole.contacts.layout)))
    whole.go(40)
    again = Run(MPI.COMM_SELF, periodic)
    numbers = fe_el.load_checkpoint(folder + "/state.h5", *again.parts)
    assert numbers["time"] == 60 * DT and numbers["name"] == "bed"
    assert again.air.time == pytest.approx(60 * DT) and again.beads.step == 60 and springs > 40
    again.go(40)
    (x, fluid, heat), (x2, fluid2, heat2) = whole.result(), again.result()
    assert x.shape == x2.shape and len(x) > 230  # some came in
    assert np.abs(x[:, :3] - x2[:, :3]).max() < 1e-10
    assert np.abs(x[:, 3:] - x2[:, 3:]).max() < 1e-5 * np.abs(x[:, 3:]).max()
    assert fluid2 == pytest.approx(fluid, rel=1e-7)
    assert heat2 == pytest.approx(heat, rel=1e-9)


@pytest.mark.ranks
def test_springs_travel_with_the_file(folder):
    """A bead held on a slope by its tangential spring alone stays; without its spring it would slip back first."""
    def held(comm):
        mesh, tags = fe_el.box((0.01, 0.01, 0.01), (3, 3, 3), comm=comm)
        beads = fe_el.Particles(mesh, 2500.0, (3.0, 0.0, -9.81))
        law = fe_el.LinearSpringDashpot(500.0, 0.5, 0.9, rolling=fe_el.RollingFriction(1.0, True))
        return beads, fe_el.Contacts(beads, law, (tags, 5))
    beads, contacts = held(MPI.COMM_WORLD)
    beads.insert_at([[0.004, 0.005, 9.99e-4]], 2e-3)
    for _ in range(400):
        beads.advance(1e-3, contacts)
    assert np.abs(beads.velocity).max(initial=0.0) < 1e-12
    fe_el.save_checkpoint(folder + "/held.h5", beads, contacts)
    again = held(MPI.COMM_SELF)
    fe_el.load_checkpoint(folder + "/held.h5", *again)
    start = again[0].position.copy()
    again[0].advance(1e-3, again[1])
    assert np.abs(again[0].position - start).max() < 1e-15 and np.abs(again[0].velocity).max() < 1e-12


@pytest.mark.ranks
def test_what_does_not_fit_is_refused(folder):
    mesh, _ = fe_el.box((1.0, 1.0), (4, 4))
    beads, air = fe_el.Particles(mesh, 1000.0), fe_el.VolumeAveragedNavierStokes(mesh)
    beads.insert_at([[0.9, 0.9]], 1e-3)
    fe_el.save_checkpoint(folder + "/a.h5", beads, air)
    other, _ = fe_el.box((1.0, 0.8), (4, 4))
    with pytest.raises(ValueError, match="mesh that it was made with"):
        fe_el.load_checkpoint(folder + "/a.h5", fe_el.Particles(other, 1000.0), fe_el.VolumeAveragedNavierStokes(other))
    fe_el.save_checkpoint(folder + "/b.h5", air)
    with pytest.raises(ValueError, match="mesh that it was made with"):
        fe_el.load_checkpoint(folder + "/b.h5", fe_el.VolumeAveragedNavierStokes(other))
    with pytest.raises(ValueError, match="in this order"):
        fe_el.load_checkpoint(folder + "/a.h5", air, beads)
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        fe_el.load_checkpoint(folder + "/none.h5", beads)
    with pytest.raises(TypeError, match="no state"):
        fe_el.save_checkpoint(folder + "/c.h5", beads, object())
    with pytest.raises(TypeError, match="parts to keep"):
        fe_el.save_checkpoint(folder + "/c.h5")
    with pytest.raises(OSError, match="cannot be written"):
        fe_el.save_checkpoint(folder + "/a.h5/b.h5", beads)


@pytest.mark.ranks
def test_output_of_a_restarted_run_goes_on_with_the_series(folder):
    """Frames from before the restart stay, those that are made again are replaced."""
    mesh, _ = fe_el.box((0.01, 0.01, 0.02), (2, 2, 4))
    beads = fe_el.Particles(mesh, 2500.0)
    beads.insert_at([[0.005] * 3], 1e-3)
    first = fe_el.ParaViewOutput(folder, beads)
    for t in range(5):
        first.write(float(t))
    second = fe_el.ParaViewOutput(folder, beads)
    for t in range(3, 7):
        second.write(float(t))
    mesh.comm.barrier()
    text = open(folder + "/particles.pvd").read()
    times = [float(t) for t in re.findall('timestep="([^"]+)" part="0"', text)]
    files = re.findall('file="([^"]+)"', text)
    assert times == [0, 1, 2, 3, 4, 5, 6] and len(set(files)) == len(files) == 7 * mesh.comm.size
    assert all((Path(folder) / f).is_file() for f in files)
