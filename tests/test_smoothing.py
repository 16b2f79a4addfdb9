"""Smoothing and mapping: integrals, self-adjointness, the Yukawa profile, linear fields."""
import numpy as np
import pytest

import fe_el
from fe_el.coupling import mapping
from fe_el.coupling.fluid_at_particles import ViscousStressMean
from fe_el.coupling.smoothing import FixedValues


def cells_of(mesh):
    from fe_el.mesh.cell_mesh import owned_corners
    return owned_corners(mesh)[0].mean(1)


def smoothings(mesh, length):
    return [fe_el.HelmholtzSmoothing(mesh, length), fe_el.PatchAverage(mesh, 3)]


@pytest.mark.ranks
@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("periodic", [True, False])
def test_smoothing_keeps_integrals_and_is_self_adjoint(which, periodic):
    mesh, _ = (fe_el.periodic_box if periodic else fe_el.box)((1.0, 1.0, 2.0), (5, 5, 10))
    smooth = smoothings(mesh, 0.4)[which]
    rng, volume = np.random.default_rng(mesh.comm.rank), smooth.nodes.volume
    a, b = rng.normal(size=(len(volume), 2)), rng.normal(size=(len(volume), 2))
    total = lambda x: mesh.comm.allreduce(x)
    assert np.allclose(total(volume @ smooth(a)), total(volume @ a), rtol=0, atol=1e-12)
    one, other = total((volume[:, None] * smooth(a) * b).sum()), total((volume[:, None] * a * smooth(b)).sum())
    assert one == pytest.approx(other, rel=1e-12)
    assert np.allclose(smooth(np.full((len(volume), 1), 3.0)), 3.0, rtol=1e-13)
    spread = total((volume[:, None] * smooth(a) ** 2).sum()) / total((volume[:, None] * a ** 2).sum())
    assert spread < 0.1


@pytest.mark.ranks
def test_smoothing_does_not_depend_on_ranks(tmp_path):
    """The second moment of a smoothed source is the same on every rank count, and grows by 2 l^2 per direction."""
    mesh, _ = fe_el.box((1.0, 1.0), (40, 40))
    smooth, x = fe_el.HelmholtzSmoothing(mesh, 0.05, tolerance=1e-8), cells_of(mesh)
    source = (np.abs(x[:, :2] - 0.5).max(1) < 0.026).astype(float)[:, None]
    volume, moment = smooth.nodes.volume, lambda f: mesh.comm.allreduce(
        (volume * f[:, 0]) @ (x[:, :2] - 0.5) ** 2) / mesh.comm.allreduce(volume @ f[:, 0])
    # cells to nodes adds about h^2 / 6
    assert np.allclose(moment(smooth(source)) - moment(source), 2 * 0.05 ** 2, rtol=0.12)


def test_point_source_gives_the_yukawa_profile():
    """exp(-r/l) / (4 pi l^2 r) in three dimensions, with an error that falls by three when the cells are halved."""
    length, errors = 0.08, []
    for n in (16, 32):
        mesh, _ = fe_el.box((1.0, 1.0, 1.0), (n, n, n))
        smooth, x = fe_el.HelmholtzSmoothing(mesh, length, tolerance=1e-8), cells_of(mesh)
        r = np.linalg.norm(x - 0.5, axis=1)
        source = np.where(r < r.min() * 1.01, 1.0, 0.0)[:, None]
        result = smooth(source / (smooth.nodes.volume @ source[:, 0]))[:, 0]
        ring = (r > 1.5 * length) & (r < 3.5 * length)
        ratio = result[ring] / (np.exp(-r / length) / (4 * np.pi * length ** 2 * r))[ring]
        errors.append(abs(np.median(ratio) - 1))
        assert result.min() > -1e-6 * result.max()
    assert errors[1] < errors[0] / 3 and errors[1] < 0.04


@pytest.mark.ranks
def test_fixed_values_keep_filled_cells_and_fill_empty_ones():
    """Eq. 5 with kappa 1e5: filled cells keep their values, empty neighbours take nearly the same."""
    mesh, _ = fe_el.box((1.0, 1.0), (16, 16))
    x = cells_of(mesh)
    filled = x[:, 0] < 0.5
    field = np.where(filled, 2.0, 0.0)[:, None]
    out = FixedValues(mesh, 0.5)(field, filled)
    assert np.array_equal(out[filled], field[filled])
    near = ~filled & (x[:, 0] < 0.55)
    assert not near.any() or (out[near] > 1.6).all() and (out[near] <= 2.0 + 1e-9).all()
    far = x[:, 0] > 0.9
    exact = 2 * np.cosh((1 - x[far, 0]) / 0.5) / np.cosh(0.5 / 0.5)
    assert np.allclose(out[far, 0], exact, rtol=0.03)


def test_cfdem_points_are_longer_in_one_direction():
    moments = mapping.cfdem_points().T @ mapping.cfdem_points() / 29
    assert np.allclose(np.diag(moments), [0.168, 0.168, 0.252], atol=1e-3)


@pytest.mark.ranks
@pytest.mark.parametrize("name", sorted(mapping.MAPPINGS))
def test_mapping_gives_away_each_particle_once_and_gathers_by_the_transpose(name):
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (4, 4, 4))
    p = fe_el.Particles(mesh, 1000.0)
    p.insert_in_box((0, 0, 0), (1, 1, 1), 200, np.linspace(0.01, 0.3, 200), seed=4)
    shares = mapping.mapping_of(name)
    shares.prepare(p.cells, p.cell, p.position, p.diameter / 2)
    rng, cells = np.random.default_rng(1), len(p.cells.volume)
    q, out = rng.normal(size=(len(p), 2)), np.zeros((cells, 2))
    shares.deposit(q, out)
    total = p.comm.allreduce(p.halo.reverse_add(out)[:p.cells.owned].sum(0))
    assert np.allclose(total, p.comm.allreduce(q.sum(0)), rtol=1e-12)
    field = p.halo.forward(rng.normal(size=(cells, 2)))
    back = np.empty_like(q)
    shares.gather(field, back)
    one = p.comm.allreduce((back * q).sum())
    assert one == pytest.approx(p.comm.allreduce((out[:p.cells.owned] * field[:p.cells.owned]).sum()), rel=1e-10)


def test_hat_mapping_is_continuous_where_satellite_points_jump():
    """A small particle that crosses a facet: the hat shares change by little, the satellite points' by a point's worth."""
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (2, 2, 2))
    jumps = {}
    for name in ("hat", "satellite_points", "particle_centred"):
        p, last, largest = fe_el.Particles(mesh, 1000.0), None, 0.0
        p.insert_at([[0.2, 0.3, 0.4]], 0.1)
        for _ in range(400):
            p.position += 1e-3 * np.array([[1.0, 0.31, 0.17]])
            p.locate()
            shares, out = mapping.mapping_of(name), np.zeros((len(p.cells.volume), 1))
            shares.prepare(p.cells, p.cell, p.position, p.diameter / 2)
            shares.deposit(np.ones((1, 1)), out)
            largest = max(largest, 0.0 if last is None else np.abs(out - last).max())
            last = out
        jumps[name] = largest
    assert jumps["hat"] < 0.003 and jumps["satellite_points"] > 0.03 and jumps["particle_centred"] == 1.0


@pytest.mark.parametrize("choice", ["cell", "linear"])
def test_linear_interpolation_sees_a_linear_velocity(choice):
    """In a shear flow the drag at a particle follows its own height with linear interpolation; with cells it jumps."""
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (4, 4, 4))
    air, p = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.0, 1e-3), fe_el.Particles(mesh, 1000.0)
    air.set_initial_velocity(lambda t, x: np.column_stack([x[:, 2], 0 * x[:, 0], 0 * x[:, 0]]))
    z = np.linspace(0.3, 0.7, 41)
    p.insert_at(np.column_stack([np.full(41, 0.41), np.full(41, 0.57), z]), 1e-4)
    c = fe_el.Coupling(p, air.velocity, air.pressure, 1.0, 1e-3, [fe_el.Drag("stokes")], mapping="particle_centred",
                       fluid_velocity=choice)
    c.to_fluid(1e-6)
    c.to_particles(1e-6)
    u = p.force[:, 0] / (3 * np.pi * 1e-3 * p.diameter) / (1 - c._gather(c.solid)[:, 0])
    error = np.abs(u - p.position[:, 2]).max()
    assert error < 0.02 if choice == "linear" else error > 0.05


@pytest.mark.ranks
def test_viscous_stress_of_a_parabolic_profile():
    """mu laplace u of u_x = y (1 - y) is -2 mu, away from the walls; what particles get the fluid loses."""
    mesh, tags = fe_el.periodic_box((1.0, 1.0), (16, 16), (True, False))
    x = cells_of(mesh)
    velocity = np.column_stack([x[:, 1] * (1 - x[:, 1]), 0 * x[:, 0]])
    inner = (x[:, 1] > 0.2) & (x[:, 1] < 0.8)
    assert np.allclose(ViscousStressMean(mesh, 3.0)(velocity)[inner], [-6.0, 0.0], atol=0.15)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.0, 3.0, stress_of_mixture=True)
    air.set_initial_velocity(lambda t, x: np.column_stack([x[:, 1] * (1 - x[:, 1]), 0 * x[:, 0]]))
    p = fe_el.Particles(mesh, 1000.0, gravity=(0, -9.81))
    p.insert_in_box((0, 0.3), (1, 0.7), 50, 0.01, seed=1)
    c = fe_el.Coupling(p, air.velocity, air.pressure, 1.0, 3.0, [fe_el.ViscousStress()])
    c.to_fluid(1e-4)
    air.advance(1e-4, c.fields)
    c.to_particles(1e-4)
    total = p.comm.allreduce(p.force.sum(0)) / p.comm.allreduce(p.volume.sum())
    assert total[0] == pytest.approx(-6.0, abs=0.3)
    assert c.momentum_imbalance < 1e-12


def test_a_neutrally_buoyant_particle_floats():
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (2, 2, 2))
    air, p = fe_el.VolumeAveragedNavierStokes(mesh, None, 800.0, 1e-3), fe_el.Particles(mesh, 800.0, (0, 0, -9.81))
    p.insert_at([[0.5, 0.5, 0.5]], 0.01)
    c = fe_el.Coupling(p, air.velocity, air.pressure, 800.0, 1e-3, [fe_el.Drag("schiller_naumann"), fe_el.Buoyancy()])
    for _ in range(5):
        c.to_fluid(0.01)
        air.advance(0.01, c.fields)
        c.to_particles(0.01)
        p.advance(0.01)
    assert np.abs(p.velocity).max() < 1e-12


def test_bad_smoothing_and_points_are_refused():
    mesh, _ = fe_el.box((1.0, 1.0), (2, 2))
    with pytest.raises(ValueError, match="smoothing length"):
        fe_el.HelmholtzSmoothing(mesh, -1.0)
    with pytest.raises(ValueError, match="repeats"):
        fe_el.PatchAverage(mesh, 0)
    with pytest.raises(ValueError, match="satellite points"):
        fe_el.SatellitePoints(np.full((2, 3), 2.0))
    with pytest.raises(ValueError, match="mean pressure gradient"):
        fe_el.PressureGradient((np.nan, 0))


@pytest.mark.parametrize("tolerance", [1e-3, 1e-2])
def test_the_polynomial_is_within_its_tolerance_on_a_mesh_with_slivers(tolerance):
    """Cell values beside those of a direct solution; the bounds of the spectrum hold its ends, and little more."""
    from scipy.sparse import csr_matrix, diags
    from scipy.sparse.linalg import eigsh, spsolve
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (6, 6, 6))
    x = mesh.geometry.x
    inner = ((x > 1e-9) & (x < 1 - 1e-9)).all(1)
    x[inner] += np.random.default_rng(0).uniform(-0.06, 0.06, (inner.sum(), 3))
    smoothing = fe_el.HelmholtzSmoothing(mesh, 0.3, tolerance)
    n = smoothing.nodes.owned_nodes
    rows = smoothing.matrix_rows
    matrix = csr_matrix((rows.value, rows.column.astype(int), rows.start.astype(int)), (n, n))
    field = np.random.default_rng(1).normal(size=(len(smoothing.nodes.dofs), 1))
    exact = smoothing.nodes.means(spsolve(matrix.tocsc(), smoothing.nodes.load(field))[:, None])
    assert np.linalg.norm(smoothing(field) - exact) < tolerance * np.linalg.norm(exact)
    scaled = diags(matrix.diagonal() ** -0.5) @ matrix @ diags(matrix.diagonal() ** -0.5)
    low, high = (eigsh(scaled, 1, which=end, return_eigenvectors=False)[0] for end in ("SA", "LA"))
    ends = smoothing.middle - smoothing.half, smoothing.middle + smoothing.half
    assert 0.8 * low < ends[0] < low and high < ends[1] < 1.2 * high
