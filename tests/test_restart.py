"""Restarts to the last bit: a run that goes on from a checkpoint is the run that wrote it, on as many ranks.

Meshes are cut into slices, as dolfinx may part the second mesh of a process in another way than the first. Slices do not
fix the order of cells and nodes in it, which follows messages: a run that is to go on to the last bit has the same mesh.
"""
import numpy as np
import pytest
from mpi4py import MPI

import fe_el

DOWN = (0.0, 0.0, -9.81)


class Scene:
    """A scene whose ``parts`` a checkpoint keeps, and which ``go``es on by steps, on a new or a given ``(mesh, tags)``."""

    def __init__(self, comm=MPI.COMM_WORLD, given=None):
        self.given = given or self.cells(comm)
        self.mesh, self.tags = self.given
        self.build()

    def state(self):
        """Everything that particles, fluid and observers know, by particle number and by place: {name: array}."""
        comm, p, out = self.mesh.comm, self.beads, {}
        order = np.argsort(np.concatenate(comm.allgather(p.id)))
        for name in ("position", "velocity", "angular_velocity", "contact_force", "force"):
            out[name] = np.concatenate(comm.allgather(getattr(p, name)))[order]
        for part in self.parts:
            if isinstance(part, fe_el.VolumeAveragedNavierStokes):
                n, d = part.num_cells, part.dimension
                out["u"] = np.concatenate(comm.allgather(np.column_stack(
                    [part.corner.mean(1).round(9), part.velocity.x.array.reshape(-1, d)[:n]])))
                out["u"] = out["u"][np.lexsort(out["u"].T[:3])][:, 3:]
            if isinstance(part, fe_el.TimeAverage):
                points, rows = part.saved()["values"]
                rows = np.concatenate(comm.allgather(np.column_stack([points.round(9), rows["mean"], rows["sum"]])))
                out["means"] = rows[np.lexsort(rows.T[:3])]
            if isinstance(part, fe_el.Probe):
                out["probe"] = np.array([np.ravel(row[1]) for row in part.rows])
        return out

    def fill(self):
        """Put the first particles in; a run that goes on from a checkpoint needs none."""


class Bed(Scene):
    """Beads in gas that is sub-cycled, with averages, a probe and a scalar."""

    dt = 5e-4

    def cells(self, comm):
        return fe_el.box((0.01, 0.01, 0.02), (2, 2, 4), comm, slices_along=2)

    def build(self):
        tags = self.tags
        self.beads = fe_el.Particles(self.mesh, 2500.0, DOWN)
        self.contacts = fe_el.Contacts(self.beads, fe_el.LinearSpringDashpot(500.0, 0.9, 0.3), (tags, (1, 2, 3, 4, 5)),
                                       steps_per_contact=12)
        self.air = fe_el.VolumeAveragedNavierStokes(self.mesh, tags, 1.2, 1.8e-5, DOWN, tolerance=1e-11)
        self.air.set_velocity(5, (0, 0, 0.9))
        self.air.set_pressure(6)
        self.air.set_no_slip((1, 2, 3, 4))
        self.cycled = fe_el.SubCycled(self.air, 2)
        self.coupling = fe_el.Coupling.of(self.cycled, self.beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient()])
        self.heat = fe_el.Scalar(self.air, 1e-4, lambda x: x[:, 2])
        self.mean = fe_el.TimeAverage(self.air.velocity)
        self.probe = fe_el.Probe([self.air.pressure], [(0.005, 0.005, 0.001)])
        self.parts = (self.beads, self.contacts, self.air, self.cycled, self.coupling, self.heat, self.mean, self.probe)

    def fill(self):
        self.beads.insert_in_box((1e-3,) * 3, (9e-3, 9e-3, 0.012), 150, 1.2e-3, seed=3, without_overlap=True)

    def go(self, steps):
        for _ in range(steps):
            self.coupling.to_fluid(self.dt)
            self.cycled.advance(self.dt, self.coupling.fields)
            self.coupling.to_particles(self.dt)
            self.beads.advance(self.dt, self.contacts)
            self.mean.add(self.dt)
            self.probe.record(self.air.time)


class Suspension(Scene):
    """A periodic suspension in adaptive steps."""

    def cells(self, comm):
        return fe_el.periodic_box((2.4e-3,) * 3, (3, 3, 3), comm=comm, slices_along=0)

    def build(self):
        down = np.array(DOWN)
        self.beads = fe_el.Particles(self.mesh, 1500.0, down)
        mixture = 0.0954 * 1500.0 + 0.9046 * 1.3
        self.air = fe_el.VolumeAveragedNavierStokes(self.mesh, None, 1.3, 1.8e-5, down, 1e-11,
                                                    mean_pressure_gradient=-mixture * down)
        self.coupling = fe_el.Coupling.of(self.air, self.beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient()])
        self.contacts = fe_el.Contacts(self.beads, fe_el.HertzMindlin(1e6, 0.3, 0.9, 0.1), steps_per_contact=12)
        self.steps = fe_el.adaptive_steps(self.air, 10.0, 0.3, first=2e-4, largest=1e-3, growth=1.05, progress=False)
        self.parts = (self.beads, self.contacts, self.air, self.coupling, self.steps)

    def fill(self):
        self.beads.insert_in_box((0, 0, 0), (2.4e-3,) * 3, 100, 2.9e-4, velocity=(0, 0, -0.05), seed=2, without_overlap=True)
        self.air.set_initial_velocity((0, 0, 0.3))

    def go(self, steps):
        for _ in range(steps):
            _, dt = next(self.steps)
            self.coupling.to_fluid(dt)
            self.air.advance(dt, self.coupling.fields)
            self.coupling.to_particles(dt)
            self.beads.advance(dt, self.contacts)


class Silo(Scene):
    """Beads that come in by an inlet at the top and leave through the bottom."""

    dt = 1e-3

    def cells(self, comm):
        return fe_el.box((0.02, 0.01, 0.03), (4, 2, 6), comm, slices_along=2)

    def build(self):
        tags = self.tags
        self.beads = fe_el.Particles(self.mesh, 2500.0, DOWN)
        self.beads.remove_at(tags, 5)
        law = fe_el.LinearSpringDashpot(500.0, 0.5, 0.5, rolling=fe_el.RollingFriction(0.1, True))
        walls = [fe_el.FacetWalls(tags, (1, 2, 3, 4)), fe_el.PlaneWall((0, 0, 0.004), (0.6, 0, 0.8))]
        self.contacts = fe_el.Contacts(self.beads, law, walls, steps_per_contact=15)
        self.inlet = fe_el.Inlet(self.beads, tags, 6, 0.02, [1e-3, 1.4e-3], (0, 0, -0.5), seed=4)
        self.parts = (self.beads, self.contacts, self.inlet)

    def fill(self):
        self.beads.insert_in_box((0.01, 1e-3, 0.012), (0.019, 9e-3, 0.02), 40, 1.2e-3, seed=3, without_overlap=True)

    def go(self, steps):
        for _ in range(steps):
            self.inlet.advance(self.dt)
            self.beads.advance(self.dt, self.contacts)


class Drum(Scene):
    """Beads in a turning cylinder between two end walls of the mesh, one of which turns, too."""

    dt = 1e-3

    def cells(self, comm):
        return fe_el.box((0.03, 0.03, 0.008), (3, 3, 1), comm, slices_along=0)

    def build(self):
        tags = self.tags
        self.beads = fe_el.Particles(self.mesh, 2500.0, (0.0, -9.81, 0.0))
        turn, axis = (0.0, 0.0, 12.0), (0.015, 0.015, 0.0)
        walls = [fe_el.CylinderWall(axis, (0, 0, 1), 0.0145, angular_velocity=turn), fe_el.FacetWalls(tags, 5),
                 fe_el.FacetWalls(tags, 6, angular_velocity=turn, point=axis)]
        self.contacts = fe_el.Contacts(self.beads, fe_el.LinearSpringDashpot(500.0, 0.5, 0.5), walls, steps_per_contact=15)
        self.parts = (self.beads, self.contacts)

    def fill(self):
        self.beads.insert_in_box((0.009, 0.005, 1e-3), (0.021, 0.02, 7e-3), 120, 1.2e-3, seed=3, without_overlap=True)

    def go(self, steps):
        for _ in range(steps):
            self.beads.advance(self.dt, self.contacts)


SCENES = [Bed, Suspension, Silo, Drum]


def compare(one, other, check):
    """Call ``check`` for each quantity of two states."""
    assert one.keys() == other.keys()
    for name in one:
        check(name, np.asarray(one[name]), np.asarray(other[name]))


def same_bits(name, a, b):
    assert a.shape == b.shape, name
    assert np.array_equal(a, b), (name, np.abs(a - b).max())


def same_to_round_off(name, a, b):
    assert a.shape == b.shape, name
    scale = np.abs(np.nan_to_num(b.astype(float))).max(initial=0.0) if b.dtype.kind in "fiub" else 0.0
    assert np.array_equal(a, b) or np.allclose(a, b, 1e-8, 1e-8 * scale, equal_nan=True), (name, np.abs(a - b).max())


@pytest.mark.ranks
@pytest.mark.parametrize("scene", SCENES)
def test_a_restarted_run_is_the_run_that_wrote_the_checkpoint_to_the_last_bit(folder, scene):
    """Of fluids on one rank: on several PETSc adds up what they have in the order of their messages, in matrices of sums and
    in multigrid (on two ranks seen with PETSc 3.22), and collisions make some thousand of that round-off in 10 ms."""
    whole = scene()
    whole.fill()
    whole.go(30)
    fe_el.save_checkpoint(folder + "/a.h5", *whole.parts)
    again = scene(given=whole.given)
    fe_el.load_checkpoint(folder + "/a.h5", *again.parts)
    compare(whole.state(), again.state(), same_bits)
    exact = whole.mesh.comm.size == 1 or not hasattr(whole, "air")
    for run in (whole, again):
        run.go(50 if exact else 20)
    compare(whole.state(), again.state(), same_bits if exact else same_to_round_off)


@pytest.mark.ranks
@pytest.mark.parametrize("scene", SCENES)
def test_a_restarted_run_is_that_of_other_ranks_and_that_without_a_break(folder, scene):
    """All ranks together go on from the file of all, and each alone; against a run that wrote no file: 1e-10 of the size."""
    whole, unbroken = scene(), scene()
    for run in (whole, unbroken):
        run.fill()
        run.go(20)
    fe_el.save_checkpoint(folder + "/a.h5", *whole.parts)
    alone = scene(MPI.COMM_SELF)
    fe_el.load_checkpoint(folder + "/a.h5", *alone.parts)
    for run in (whole, unbroken, alone):
        run.go(20)
    for other in (unbroken, alone):
        for name, a in whole.state().items():
            b = np.asarray(other.state()[name])
            if name in ("position", "velocity", "u"):
                assert np.abs(np.asarray(a) - b).max() < 1e-10 * max(np.abs(b).max(), 1.0), name


@pytest.mark.ranks
def test_a_state_that_was_just_loaded_can_be_saved(folder):
    """Its springs are still there: the tangential ones would be lost with the first lists."""
    whole = Silo()
    whole.fill()
    whole.go(60)
    fe_el.save_checkpoint(folder + "/a.h5", *whole.parts)
    again, third = Silo(given=whole.given), Silo(given=whole.given)
    fe_el.load_checkpoint(folder + "/a.h5", *again.parts)
    fe_el.save_checkpoint(folder + "/b.h5", *again.parts)
    fe_el.load_checkpoint(folder + "/b.h5", *third.parts)
    for run in (whole, again, third):
        run.go(5)
    compare(whole.state(), third.state(), same_bits)
    compare(whole.state(), again.state(), same_bits)


@pytest.mark.ranks
@pytest.mark.parametrize("scene", SCENES)
def test_a_hundred_steps_are_the_same_on_any_number_of_ranks(scene):
    """Mean places and momenta, energies and numbers of particles against the run of each rank alone: 1e-10 of their size.

    Of beds that collide for 20 ms and of silo and drum for 40 ms: collisions make up to ten thousand of round-off in 10 ms.
    """
    together, alone, sums = scene(), scene(MPI.COMM_SELF), []
    for run in (together, alone):
        run.dt = 0.4 * getattr(scene, "dt", 0.0)  # the suspension has steps of its own
        run.fill()
        run.go(100)
        p, air = run.beads, next((a for a in run.parts if isinstance(a, fe_el.VolumeAveragedNavierStokes)), None)
        where = p.comm.allreduce((p.mass[:, None] * p.position).sum(0)) / p.comm.allreduce(p.mass.sum())
        size = p.comm.allreduce((p.mass * np.linalg.norm(p.velocity, axis=1)).sum())
        flow = air.momentum() / (air.density * p.comm.allreduce(air.volume.sum())) if air else np.zeros(1)
        sums.append(np.concatenate([where, p.momentum() / size, [p.kinetic_energy() / size, p.total_number], flow]))
    assert sums[0] == pytest.approx(sums[1], rel=1e-10, abs=1e-11)


@pytest.mark.ranks
def test_a_checkpoint_keeps_the_eddy_viscosity_and_the_kind_of_pressure_force(folder):
    """What turbulent dispersion reads of the step before; and a run does not go on with another pressure force."""
    mesh, tags = fe_el.box((0.04,) * 3, (4,) * 3)

    def scene(at_end):
        air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.2, 1.8e-5, turbulence=fe_el.Smagorinsky())
        air.set_velocity(1, (1.0, 0, 0))
        air.set_no_slip((3, 4, 5, 6))
        air.set_pressure(2)
        beads = fe_el.Particles(mesh, 2500.0)
        return air, beads, fe_el.Coupling.of(air, beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient(at_end=at_end)])
    air, beads, coupling = scene(True)
    for _ in range(2):
        coupling.to_fluid(1e-3)
        air.advance(1e-3, coupling.fields)
        coupling.to_particles(1e-3)
    fe_el.save_checkpoint(folder + "/a.h5", air, beads, coupling)
    again = scene(True)
    fe_el.load_checkpoint(folder + "/a.h5", *again)
    assert air.eddy_viscosity.max() > 0 and (again[0].eddy_viscosity == air.eddy_viscosity).all()
    with pytest.raises(ValueError, match="has 6 fields, this one 3.*at_end=True"):
        fe_el.load_checkpoint(folder + "/a.h5", *scene(False))
