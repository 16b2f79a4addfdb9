"""A user's own pieces, each in a few lines of public names: this file imports nothing else of the package."""
import ast
from pathlib import Path

import meshio
import numpy as np
import pytest

import fe_el


def test_own_lift_force():
    """A shear lift V rho C (u - v) x curl u: what particles gain the fluid loses, to round-off, as with drag."""
    class Lift:
        needs = ("slip", "vorticity")

        def force(self, fluid):
            return 0.5 * fluid.density * fluid.volume[:, None] * np.cross(fluid.slip, fluid.vorticity)

    mesh, _ = fe_el.periodic_box((0.02, 0.02, 0.02), (4, 4, 4), (True, True, True))
    air = fe_el.VolumeAveragedNavierStokes(mesh, density=1.2, viscosity=1.8e-5)
    air.set_initial_velocity(lambda time, x: np.column_stack([np.sin(314 * x[:, 1]), 0 * x[:, 0], 0 * x[:, 0]]))
    beads = fe_el.Particles(mesh, 1000.0)
    beads.insert_in_box((0, 0, 0), (0.02, 0.02, 0.02), 100, 1e-3, seed=1)
    coupling = fe_el.Coupling.of(air, beads, [fe_el.Drag("beetstra"), Lift()])
    for _ in range(3):
        coupling.to_fluid(1e-4)
        air.advance(1e-4, coupling.fields)
        coupling.to_particles(1e-4)
        beads.advance(1e-4)
    assert coupling.momentum_imbalance < 1e-12 and np.abs(beads.force[:, 1]).max() > 0


def test_own_drag_law():
    """F = 1 + Re / 24 * 0.5: the settling velocity that balances the weight."""
    mesh, _ = fe_el.box((0.1, 0.1, 0.1), (1, 1, 1))
    air = fe_el.VolumeAveragedNavierStokes(mesh, density=1.0, viscosity=1e-3)
    bead = fe_el.Particles(mesh, 1000.0, gravity=(0, 0, -9.81))
    bead.insert_at([[0.05, 0.05, 0.09]], 1e-4)
    coupling = fe_el.Coupling(bead, air.velocity, air.pressure, 1.0, 1e-3,
                              [fe_el.Drag(lambda solid_fraction, reynolds: 1 + reynolds / 48)])
    for _ in range(40):
        coupling.to_fluid(1e-3)
        coupling.to_particles(1e-3)
        bead.advance(1e-3)
    speed = -bead.velocity[0, 2]
    reynolds = 1.0 * speed * 1e-4 / 1e-3
    assert 3 * np.pi * 1e-3 * 1e-4 * speed * (1 + reynolds / 48) == pytest.approx(bead.mass[0] * 9.81, rel=1e-4)


def test_own_contact_law():
    """A spring that is weaker when it lets go: the restitution is the root of the ratio of both stiffnesses."""
    def law(overlap, normal_velocity, tangential_velocity, spring, reduced_mass, reduced_radius, dt):
        stiffness = np.where(normal_velocity < 0, 100.0, 49.0)
        return stiffness * overlap, 0 * tangential_velocity, spring

    mesh, _ = fe_el.box((0.1, 0.1, 0.1), (1, 1, 1))
    beads = fe_el.Particles(mesh, 1000.0)
    beads.insert_at([[0.04, 0.05, 0.05], [0.0501, 0.05, 0.05]], 0.01, velocity=[[0.1, 0, 0], [-0.1, 0, 0]])
    shortest = np.pi * np.sqrt(beads.mass[0] / 2 / 100)
    contacts = fe_el.Contacts(beads, fe_el.ArrayLaw(law, shortest), steps_per_contact=400)
    for _ in range(10):
        beads.advance(shortest / 4, contacts)
    assert beads.velocity[:, 0] == pytest.approx([-0.07, 0.07], rel=0.01)


def test_own_wall_shape():
    """A bowl of revolution z = 10 (x^2 + y^2): a bead swings in it as a pendulum does, sqrt(2 g 10) times in 2 pi."""
    sides, rings = 64, 24
    angle, radius = np.meshgrid(2 * np.pi * np.arange(sides) / sides, 0.03 * np.arange(1, rings + 1) / rings)
    ring = np.column_stack([(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel(), 10 * radius.ravel() ** 2])
    k, n = np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing="ij")
    a, b = (k * sides + n).ravel() + 1, (k * sides + (n + 1) % sides).ravel() + 1
    fan = np.column_stack([np.zeros(sides, int), np.arange(sides) + 1, (np.arange(sides) + 1) % sides + 1])
    triangles = np.concatenate([fan, np.column_stack([a, b, a + sides]), np.column_stack([b, b + sides, a + sides])])
    points = np.concatenate([[[0, 0, 0]], ring]) + [0.05, 0.05, 0.05]
    bowl = fe_el.SurfaceWall((points, triangles), may_be_open=True)
    mesh, _ = fe_el.box((0.1, 0.1, 0.1), (2, 2, 2))
    bead = fe_el.Particles(mesh, 2500.0, gravity=(0, 0, -9.81))
    bead.insert_at([[0.055, 0.05, 0.05025 + 5.2e-4]], 1e-3)
    contacts = fe_el.Contacts(bead, fe_el.LinearSpringDashpot(50.0, 0.2, 0.0), bowl)
    along = [bead.advance(1e-3, contacts) or bead.position[0, 0] - 0.05 for _ in range(600)]
    turns = np.flatnonzero(np.diff(np.sign(along)))
    assert 2 * np.diff(turns).mean() * 1e-3 == pytest.approx(2 * np.pi / np.sqrt(20 * 9.81), rel=0.05)


def test_own_boundary_velocity():
    """A jet that grows in time from a part of a boundary: what comes in is the integral of its profile."""
    def jet(time, x):
        inside = np.maximum(1 - ((x[:, 1] - 0.5) / 0.25) ** 2, 0.0)
        return np.column_stack([min(time, 1.0) * inside, 0 * inside])

    mesh, tags = fe_el.box((1.0, 1.0), (16, 32))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.0, viscosity=0.01)
    air.set_velocity(1, jet)
    air.set_pressure(2, 0.0)
    for _ in range(10):
        air.advance(0.1)
    assert air.velocity.x.array.reshape(-1, 2)[:, 0].max() > 0.5
    assert air.momentum()[0] == pytest.approx(1 / 3, rel=0.01)  # of a jet of 1 m/s and 0.5 m: 2/3 of it


def test_own_output_quantity(tmp_path):
    """The temperature of beads that cool travels with them, and is written beside the rest."""
    mesh, _ = fe_el.box((0.1, 0.1, 0.1), (2, 2, 2))
    beads = fe_el.Particles(mesh, 1000.0)
    beads.insert_in_box((0.02,) * 3, (0.08,) * 3, 50, 1e-3, seed=1)
    beads.properties["temperature"] = np.full(len(beads), 400.0)
    output = fe_el.ParaViewOutput(tmp_path, beads)
    for time in fe_el.time_steps(0.1, 1.0, progress=False):
        beads.properties["temperature"] += 0.1 * (300.0 - beads.properties["temperature"])
        beads.advance(0.1)
        output.write(time)
    written = [meshio.read(file).point_data["temperature"] for file in sorted(tmp_path.glob("particles_*.vtu"))]
    assert [w[0] for w in written] == pytest.approx(300 + 100 * 0.9 ** np.arange(1, 11))


def test_pieces_are_short_and_of_public_names():
    """At most 25 lines each, and no module of the package by name."""
    tree = ast.parse(Path(__file__).read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_own"):
            assert node.end_lineno - node.lineno <= 25, node.name
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            names = [node.module] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
            assert not any(str(name).startswith("fe_el.") for name in names)
