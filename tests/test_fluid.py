"""The fluid alone: rest, packed beds and conservation."""
import gc
import tracemalloc

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import fe_el
from fe_el.dolfinx_api import scalar_space, vector_space
from fe_el.nodes.nodal_matrix import NodalMatrix


@pytest.mark.ranks
def test_rest_under_gravity_with_random_void_fraction_and_drag():
    mesh, tags = fe_el.box((0.1, 0.1), (12, 12))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, gravity=(0, -9.81), tolerance=1e-13)
    for side in (1, 2, 3, 4):
        air.set_no_slip(side)
    scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
    phi, drag, source = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
    n = air.num_cells
    rng = np.random.default_rng(mesh.comm.rank)
    phi.x.array[:n] = rng.uniform(0.36, 1, n)
    drag.x.array[:n] = 10 ** rng.uniform(-3, 8, n) * rng.integers(0, 2, n)
    for _ in range(30):
        air.advance(1e-3, (phi, drag, source))
    assert np.abs(air.velocity.x.array).max(initial=0) < 1e-10 * np.sqrt(9.81 * 0.1)


@pytest.mark.ranks
def test_pressure_drop_of_a_packed_bed_below_a_freeboard_is_exact():
    """-dp/dx = beta u / phi at dt beta / rho = 8850, with drag beside none (superficial velocity U = phi u)."""
    mesh, tags = fe_el.box((0.05, 0.2), (6, 24))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.13, viscosity=1.77e-5, tolerance=1e-12)
    beta, speed, void = 1e7, 1.3, 0.42
    air.set_velocity(3, (0, speed))
    air.set_pressure(4, 0.0)
    air.set_slip(1)
    air.set_slip(2)
    air.set_initial_velocity((0, speed))
    scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
    phi, drag, source = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
    inside = air.corner[:, :, 1].mean(1) < 0.1
    phi.x.array[:air.num_cells] = np.where(inside, void, 1.0)
    drag.x.array[:air.num_cells] = np.where(inside, beta, 0.0)
    for _ in range(200):
        air.advance(1e-3, (phi, drag, source))
    drop = mesh.comm.allreduce(air.pressure.x.array.max(), op=MPI.MAX)
    assert drop == pytest.approx(beta * speed / void ** 2 * 0.1, rel=1e-5)


def test_plane_poiseuille():
    """A developed profile stays as it is between no-slip walls, with dp/dx = -8 mu U / H^2 (both to 1 % on 16 squares)."""
    mesh, tags = fe_el.box((2.0, 1.0), (32, 16))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.0, viscosity=0.1, tolerance=1e-10)
    air.set_velocity(1, lambda t, x: np.column_stack([4 * x[:, 1] * (1 - x[:, 1]), 0 * x[:, 1]]))
    for side in (3, 4):
        air.set_no_slip(side)
    air.set_pressure(2, 0.0)
    for _ in range(200):
        air.advance(0.05)
    x = air.corner.mean(1)
    u = air.velocity.x.array.reshape(-1, 2)[:, 0]
    middle = np.abs(x[:, 0] - 1.0) < 0.3
    assert np.abs(u - 4 * x[:, 1] * (1 - x[:, 1]))[middle].max() < 0.01
    at = lambda where: air.pressure.x.array[np.isclose(air.node_position[:, 0], where)].mean()
    assert at(0.5) - at(1.5) == pytest.approx(0.8, rel=0.01)


def test_bad_input_is_refused():
    mesh, tags = fe_el.box((1.0, 1.0), (2, 2))
    with pytest.raises(ValueError, match="density"):
        fe_el.VolumeAveragedNavierStokes(mesh, tags, density=-1.0)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags)
    with pytest.raises(ValueError, match="boundary group 9"):
        air.set_no_slip(9)
    with pytest.raises(ValueError, match="time step"):
        air.advance(-0.1)
    with pytest.raises(ValueError, match="velocity"):
        air.set_velocity(1, (0.0, np.nan))


@pytest.mark.ranks
def test_a_lid_may_slide_over_a_closed_box_but_nothing_may_flow_in():
    mesh, tags = fe_el.box((1.0, 1.0), (4, 4))
    for velocity, fails in (((1.0, 0.0), False), ((1.0, -1e-3), True)):
        air = fe_el.VolumeAveragedNavierStokes(mesh, tags)
        air.set_velocity(4, velocity)
        if fails:
            with pytest.raises(ValueError, match="without outlet"):
                air.advance(0.1)
        else:
            air.advance(0.1)


@pytest.mark.parametrize("scene", ["one phase", "moving void fraction"])
def test_a_step_asks_the_system_for_no_arrays(scene):
    """All that Python and numpy ask for in a step, added up at its largest, is less than a fifth of one array of the
    cells; what others left to the collector does not count."""
    mesh, tags = fe_el.box((0.5, 1.0), (32, 64))
    moving = scene == "moving void fraction"
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.2, 1e-3, gravity=(0, -9.81),
                                           stabilisation=fe_el.Streamline() if moving else None)
    air.set_velocity(3, (0.0, 1.0))
    air.set_pressure(4, 0.0)
    air.set_slip(1)
    air.set_no_slip(2)
    heat = fe_el.Scalar(air, 1e-3, 0.0, "temperature")
    heat.set_value(3, 1.0)
    scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
    phi, drag, source = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
    y, asked = air.corner[:, :, 1].mean(1), []
    gc.collect()
    gc.disable()
    for k in range(8):
        phi.x.array[:] = 0.8 + 0.1 * np.sin(6 * y - 0.1 * k)
        drag.x.array[:] = 100 * (1 - phi.x.array)
        tracemalloc.start()
        air.advance(0.005, (phi, drag, source) if moving else None)
        heat.advance(0.005)
        asked.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    gc.enable()
    assert min(asked) > 0 and max(asked[4:]) < 0.2 * y.nbytes


@pytest.mark.ranks
def test_a_nodal_matrix_is_the_sum_of_its_elements_with_and_without_fixed_nodes():
    """Products of PETSc's matrix and of the rows of each rank against the elements; fixed nodes split off what they
    carry."""
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (3, 3, 3))
    air = fe_el.VolumeAveragedNavierStokes(mesh)
    matrix, rng, own = NodalMatrix(air.space, air.dofs), np.random.default_rng(mesh.comm.rank), air.owned_nodes
    elements = rng.normal(size=(air.num_cells, 4, 4))
    elements[:, range(4), range(4)] += 5.0
    matrix.add(elements)
    for parts in (1, 2, 3):
        u = np.sin(air.node_position[:, :parts] * 7 + 1)
        by_elements, by_rows = np.zeros_like(u), np.zeros_like(u)
        np.add.at(by_elements, air.dofs, np.einsum("cij,cjk->cik", elements, u[air.dofs]))
        matrix.subtract_product(u, by_rows)
        assert np.allclose(by_rows, -by_elements, atol=1e-12)
    air.complete(by_elements)
    fixed = air.node_position[:, 0] < 1e-9
    lift, x, y = np.zeros((air.nodes, 3)), *matrix.matrix.createVecs()
    for hold in (False, True, False):
        if hold:
            matrix.fix(fixed, lift, u)
            air.complete(lift)
        matrix.assemble()
        x.array[:] = u[:own, 0]
        matrix.matrix.mult(x, y)
        expected, free = by_elements[:own, 0] + hold * lift[:own, 0], ~fixed[:own]
        assert np.allclose(y.array[free], expected[free], atol=1e-12)
        if hold:
            assert np.allclose(y.array[~free], matrix.diagonal()[~free] * u[:own, 0][~free], atol=1e-12)
            assert (matrix.diagonal()[~free] > 0).all()
            matrix.release()


@pytest.mark.ranks
def test_more_fluid_than_room_for_it_is_refused_at_any_time():
    """A ramped inlet, a mass source, and particles that displace fluid, in a closed box: a sentence at the step it
    happens."""
    for name in ("ramp", "mass source", "particles"):
        mesh, tags = fe_el.box((0.01, 0.01), (4, 4))
        air = fe_el.VolumeAveragedNavierStokes(mesh, tags)
        scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
        fields = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
        fields[0].x.array[:] = 1.0
        if name == "ramp":
            air.set_velocity(1, fe_el.ramp((0.1, 0.0), 0.01))
        if name == "mass source":
            air.mass_source = lambda t, x: 1.0 if t > 2e-3 else 0.0
        with pytest.raises(ValueError, match="domain without outlet"):
            for k in range(6):
                fields[0].x.array[:] = 0.9 if name == "particles" and k > 2 else 1.0
                air.advance(1e-3, fields)


def test_parameters_of_a_geometry_hold_for_one_mesh_and_are_checked():
    """The next mesh has the defaults again; a misspelt name is refused."""
    def size(**parameters):
        mesh = fe_el.mesh_geo("meshes/hopper.geo", **parameters)[0]
        return mesh.topology.index_map(3).size_local, mesh.geometry.x[:, 0].max()
    first, other = size(), size(width=0.2, size=0.012)
    assert size() == first and other[1] == pytest.approx(0.2)
    with pytest.raises(ValueError, match="widht.*bin, cone"):
        size(widht=0.3)
