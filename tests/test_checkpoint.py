"""Checkpoints: a run that goes on from a file is the run without a break, on any number of ranks."""
import os
import re
import subprocess
import sys
import time
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
    springs = whole.mesh.comm.allreduce(sum(len(k[0]) for k in whole.contacts.lists.collect(whole.contacts.step,
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


@pytest.mark.ranks
def test_output_has_what_paraview_is_to_show(folder):
    """Forces, density and material of beads, and lines of contacts with the force of their springs, all compressed."""
    import meshio
    mesh, tags = fe_el.box((0.01, 0.01, 0.02), (2, 2, 4))
    beads = fe_el.Particles(mesh, 2500.0)
    beads.insert_at([(0.005, 0.005, 0.009), (0.005, 0.005, 0.0098), (0.005, 0.005, 0.015)], 1e-3, density=[1.0, 2.0, 3.0],
                    velocity=[(0, 0, 0), (0, 0, 0), (1.0, 0, 0)])
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags)
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(100.0, 1.0, 0.0))
    out = fe_el.ParaViewOutput(folder, beads, [air.velocity, air.pressure], contacts=contacts)
    out.write(0.0)
    beads.advance(1e-12, contacts)
    out.write(1.0)
    mesh.comm.barrier()
    ranks = range(mesh.comm.size)
    files = [[f"{folder}/{name}_00001_{r}.vtu" for r in ranks] for name in ("particles", "contacts")]
    beads, links = ([meshio.read(file) for file in of if b'NumberOfPoints="0"' not in Path(file).read_bytes()]
                    for of in files)  # meshio reads no piece without points
    data = {key: np.concatenate([p.point_data[key] for p in beads]) for key in beads[0].point_data}
    assert {"density", "material", "force", "contact_force", "id", "diameter", "coarse_graining"} <= set(data)
    assert sorted(data["density"]) == [1.0, 2.0, 3.0]
    assert np.sort(data["contact_force"][:, 2]) == pytest.approx([-0.02, 0.0, 0.02], abs=1e-9)
    lines = [c for p in links for block in p.cell_data["normal_force"] for c in block]
    ends = np.concatenate([p.points for p in links])
    assert lines == pytest.approx([0.02]) and sorted(ends[:, 2]) == pytest.approx([0.009, 0.0098])
    text = Path(f"{folder}/fluid_00001_0.vtu").read_bytes()
    assert b"vtkZLibDataCompressor" in text and b'format="binary"' in text


def small_run(path):
    """A file with a handful of beads in a fluid."""
    mesh, tags = fe_el.box((0.01, 0.01, 0.01), (2, 2, 2))
    beads, air = fe_el.Particles(mesh, 2500.0), fe_el.VolumeAveragedNavierStokes(mesh, tags)
    beads.insert_in_box((0.001,) * 3, (0.009,) * 3, 50, 1e-4, velocity=(0.1, 0.2, 0.3))
    fe_el.save_checkpoint(path, beads, air, time=0.5)
    return beads, air


def test_damaged_files_are_refused_and_change_nothing(tmp_path):
    """Two hundred files with a flipped bit anywhere, in the header too, cut short, in disorder, no checkpoint at all: a
    sentence, parts as they were."""
    path, bad = str(tmp_path / "a.h5"), tmp_path / "b.h5"
    beads, air = small_run(path)
    good, random = Path(path).read_bytes(), np.random.default_rng(0)
    before = beads.position.copy()
    places = [*random.integers(0, 8 * len(good), 140), *random.integers(0, 8 * 110, 30)]
    copies = [good[:b // 8] + bytes([good[b // 8] ^ 1 << int(b % 8)]) + good[b // 8 + 1:] for b in places]
    cut = [good[:n] for n in random.integers(1, len(good) - 1, 20)]
    mixed = [good[:n] + good[n + 64:] + good[n:n + 64] for n in random.integers(600, len(good) - 200, 10) if
             good[n:n + 64] != good[n + 64:n + 128]]
    for content in (*copies, *cut, *mixed, good[:-1], good[:700], good + b"x", b"", b"no checkpoint", good[512:]):
        bad.write_bytes(content)
        with pytest.raises(ValueError, match="damaged|of version|plain HDF5"):
            fe_el.load_checkpoint(bad, beads, air)
    for content, said in ((good.replace(b"version 2", b"version 9", 1), "is of version 9, and this fe_el reads version 2;"),
                          (good[512:], "as fe_el 0.1.0 wrote it, and this fe_el reads version 2;")):
        bad.write_bytes(content)
        with pytest.raises(ValueError, match=said):
            fe_el.load_checkpoint(bad, beads, air)
    assert np.array_equal(beads.position, before)
    assert fe_el.load_checkpoint(path, beads, air) == {"time": 0.5} and np.array_equal(beads.position, before)


@pytest.mark.ranks
def test_what_cannot_be_read_or_written_is_one_sentence_on_all_ranks(folder):
    small_run(folder + "/a.h5")
    mesh, tags = fe_el.box((0.01, 0.01, 0.01), (2, 2, 2))
    beads, air = fe_el.Particles(mesh, 2500.0), fe_el.VolumeAveragedNavierStokes(mesh, tags)
    if MPI.COMM_WORLD.rank == 0:
        content = bytearray(Path(folder + "/a.h5").read_bytes())
        content[5000] ^= 16
        Path(folder + "/b.h5").write_bytes(content)
    MPI.COMM_WORLD.barrier()
    with pytest.raises(ValueError, match="damaged"):
        fe_el.load_checkpoint(folder + "/b.h5", beads, air)
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        fe_el.load_checkpoint(folder, beads, air)
    with pytest.raises(OSError, match="cannot be written"):
        fe_el.save_checkpoint(folder + "/c.h5", beads, note={"a": 1})
    assert not len(beads)


def test_a_full_disk_leaves_the_older_file_and_no_part(tmp_path):
    """Here a limit of the file size in a process of its own: an OSError with the promised sentence."""
    script = f"""
import resource, signal, fe_el
from tests.test_checkpoint import small_run
beads, air = small_run({str(tmp_path / 'a.h5')!r})
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
try:
    fe_el.save_checkpoint({str(tmp_path / 'a.h5')!r}, beads, air, time=1.0)
except OSError as error:
    print("said:", error)
"""
    run = subprocess.run([sys.executable, "-W", "ignore", "-c", script], capture_output=True, text=True, timeout=120)
    assert run.returncode == 0 and re.search("said: The checkpoint .* cannot be written: .*large", run.stdout)
    assert [f.name for f in tmp_path.iterdir()] == ["a.h5"]
    mesh, tags = fe_el.box((0.01, 0.01, 0.01), (2, 2, 2))
    beads = fe_el.Particles(mesh, 2500.0)
    assert fe_el.load_checkpoint(tmp_path / "a.h5", beads, fe_el.VolumeAveragedNavierStokes(mesh, tags)) == {"time": 0.5}


def test_the_part_of_a_killed_run_is_removed(tmp_path):
    for name, age in (("old.h5.part", 3600), ("new.h5.part", 0), ("other.part", 3600)):
        (tmp_path / name).write_bytes(b"x")
        os.utime(tmp_path / name, (time.time() - age,) * 2)
    small_run(tmp_path / "a.h5")
    assert sorted(f.name for f in tmp_path.iterdir()) == ["a.h5", "new.h5.part", "other.part"]


class Watched:
    """A flow with everything that watches it and chooses its steps."""

    def __init__(self, mesh):
        self.air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.0, 0.1, tolerance=1e-13)
        self.cycled = fe_el.SubCycled(self.air, 2)
        self.void_fraction = fe_el.Coupling(fe_el.Particles(mesh, 1000.0), self.air.velocity, self.air.pressure, 1.0, 0.1,
                                            [fe_el.PressureGradient()]).fields
        self.means = [fe_el.TimeAverage(f) for f in (self.air.velocity, self.air.pressure, self.cycled.mean_pressure)]
        self.probe = fe_el.Probe([self.air.velocity, self.air.pressure], [(1.0, 2.0), (3.0, 0.5)])
        self.steps = fe_el.adaptive_steps(self.air, 2.0, courant=0.4, first=0.01, growth=1.1, progress=False)
        self.parts = (self.air, self.cycled, *self.means, self.probe, self.steps)

    def go(self, number):
        for _ in range(number):
            time, dt = next(self.steps)
            self.cycled.advance(dt, self.void_fraction)
            for mean in self.means:
                mean.add(dt)
            self.probe.record(time)


@pytest.mark.ranks
def test_observers_sub_cycling_and_adaptive_steps_go_on(folder):
    """Averages, variances, probes and steps of a restarted run are those of the run without a break."""
    mesh, _ = fe_el.periodic_box((2 * np.pi, 2 * np.pi), (8, 8))
    whole = Watched(mesh)
    whole.air.set_initial_velocity(lambda t, x: np.column_stack([np.sin(x[:, 0]) * np.cos(x[:, 1]),
                                                                 -np.cos(x[:, 0]) * np.sin(x[:, 1])]))
    whole.go(6)
    fe_el.save_checkpoint(folder + "/a.h5", *whole.parts)
    again = Watched(mesh)
    fe_el.load_checkpoint(folder + "/a.h5", *again.parts)
    assert again.cycled.mean_velocity.x.array == pytest.approx(whole.cycled.mean_velocity.x.array, abs=1e-15)
    whole.go(6)
    again.go(6)
    assert again.steps.dt == pytest.approx(whole.steps.dt, rel=1e-10) and again.air.step == whole.air.step
    assert len(again.probe.rows) == 12 and again.probe.rows[0][0] == whole.probe.rows[0][0]
    for one, other in zip(whole.probe.rows, again.probe.rows):
        assert all(np.allclose(a, b, rtol=1e-9, atol=1e-10) for a, b in zip(one, other))
    for one, other in zip(whole.means, again.means):
        assert other.duration == pytest.approx(one.duration) and other.mean == pytest.approx(one.mean, abs=1e-10)
        assert other.variance == pytest.approx(one.variance, abs=1e-10) and one.variance.max() > 1e-8


@pytest.mark.ranks
def test_a_users_class_keeps_itself(folder):
    class Counter:
        count = 0

        def saved(self):
            return {"same": (None, {"count": self.count})}

        def restore(self, state):
            self.count = int(state["same"]["count"])

    mesh, _ = fe_el.box((1.0, 1.0), (4, 4))
    beads, one, other = fe_el.Particles(mesh, 1000.0), Counter(), Counter()
    beads.insert_at([[0.9, 0.9]], 1e-3)
    one.count = 7
    fe_el.save_checkpoint(folder + "/a.h5", beads, one)
    fe_el.load_checkpoint(folder + "/a.h5", beads, other)
    assert other.count == 7


def test_contacts_of_other_walls_are_refused(tmp_path):
    """In a sentence, and what they were given before stays."""
    mesh, tags = fe_el.box((0.01,) * 3, (2, 2, 2))
    beads = fe_el.Particles(mesh, 2500.0)
    beads.insert_at([(0.005,) * 3], 1e-3)
    floor, side = fe_el.FacetWalls(tags, 5), fe_el.FacetWalls(tags, 1)
    law = fe_el.LinearSpringDashpot(100.0, 0.5, 0.3)
    fe_el.save_checkpoint(tmp_path / "a.h5", fe_el.Contacts(beads, law, [floor, side]))
    with pytest.raises(ValueError, match="have 1 walls, those of the checkpoint had 2"):
        fe_el.load_checkpoint(tmp_path / "a.h5", fe_el.Contacts(beads, law, [floor]))
