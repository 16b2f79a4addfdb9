"""Periodic boxes, slices per rank, and the branches of the coupling that only some scenes use."""
import itertools

import numpy as np
import pytest

import fe_el
from demos.sedimenting_suspension import Suspension
from fe_el import time_scales
from fe_el.dolfinx_api import geometry_nodes
from fe_el.mesh.cell_mesh import cell_mesh

BOXES = [((1.0, 2.0, 0.5), (4, 6, 3), None), ((1.0, 2.0, 0.5), (4, 6, 3), (True, False, True)), ((1.0, 2.0), (4, 6), None),
         ((1.0, 2.0), (4, 6), (False, True))]


@pytest.mark.ranks
@pytest.mark.parametrize("slices_along", [None, 0])
@pytest.mark.parametrize("lengths, cells, periodic", BOXES)
def test_particles_cross_periodic_sides_on_straight_lines(by_id, lengths, cells, periodic, slices_along):
    """Volume and boundary are those of the box, and every particle is where its velocity takes it, wrapped."""
    mesh, tags = fe_el.periodic_box(lengths, cells, periodic, slices_along=slices_along)
    arrays, _ = cell_mesh(mesh, 0.3, 1.0, mesh.period)
    assert mesh.comm.allreduce(arrays.volume[:arrays.owned].sum()) == pytest.approx(np.prod(lengths), rel=1e-12)
    assert mesh.comm.allreduce(int((arrays.neighbour[:arrays.owned] < 0).sum())) == mesh.comm.allreduce(len(tags.values))
    p = fe_el.Particles(mesh, 1000.0)
    p.insert_in_box((0.0,) * len(lengths), lengths, 300, 0.01, seed=1)
    start = by_id(p, p.position)
    v = np.where(mesh.period > 0, np.random.default_rng(3).normal(size=(300, 3)), 0.0)
    p.velocity[:] = v[p.id]
    for _ in range(20):
        p.advance(0.05)
    period = np.where(mesh.period > 0, mesh.period, 1e9)
    error = start + v - by_id(p, p.position)
    assert np.abs(error - np.round(error / period) * period).max() < 1e-13 and p.total_number == 300


@pytest.mark.ranks
def test_slices_share_out_the_cells_evenly():
    mesh, tags = fe_el.box((4.0, 1.0, 1.0), (12, 3, 3), slices_along=0)
    owned = mesh.comm.allgather(mesh.topology.index_map(3).size_local)
    assert sum(owned) == 648 and max(owned) - min(owned) <= 1
    assert mesh.comm.allreduce(len(tags.values)) >= 2 * 2 * (9 + 2 * 36)
    centre = mesh.geometry.x[geometry_nodes(mesh)[:owned[mesh.comm.rank]]].mean(1)[:, 0]
    spans = mesh.comm.allgather((centre.min(), centre.max()))
    assert all(a[1] <= b[0] + 0.35 for a, b in itertools.pairwise(spans))
    with pytest.raises(ValueError, match="slices_along"):
        fe_el.box((1.0, 1.0), (2, 2), slices_along=2)


@pytest.mark.ranks
@pytest.mark.parametrize("scheme", ["implicit", "implicit_from_force", "split", "void_cells_explicit", "explicit",
                                    "conservative"])
def test_every_scheme_runs_with_smoothing_and_in_the_same_fields(scheme):
    """With smoothing (and eq. 5 for the mean velocity) all schemes give the same slip at a small step within a few per
    cent."""
    scene = Suspension(150e-6, 1500.0, 0.1, (24, 24, 24), (6, 6, 6), scheme, "beetstra", "satellite_points", "cell", 2.0,
                       1.0,
                       False, 1)
    for _ in range(20):
        scene.advance(1e-5)
    assert scene.mean_slip() == pytest.approx(scene.slip, rel=0.03)
    assert scene.coupling.solid_volume_error < 1e-12


@pytest.mark.ranks
def test_patch_average_keeps_momentum_too():
    scene = Suspension(150e-6, 1500.0, 0.1, (24, 24, 24), (6, 6, 6), "conservative", "beetstra", "satellite_points",
                       "linear", None,
                       1.0, False, 1)
    old = scene.coupling
    scene.coupling = fe_el.Coupling(scene.beads, scene.air.velocity, scene.air.pressure, 1.3, 1.8e-5,
                                    [old.drag, old.pressure_force],
                                    smoothing=fe_el.PatchAverage(scene.mesh, 2), fluid_velocity="linear")
    scene.coupling.to_fluid(1e-4)
    before = scene.momentum()
    for _ in range(5):
        scene.advance(1e-4)
        assert scene.coupling.momentum_imbalance < 1e-12
    assert np.abs(scene.momentum() - before).max() < 1e-12 * scene.weight * 5e-4


def test_polydisperse_drag_in_a_mixture_acts_on_both_sizes():
    """In a well-mixed bidisperse cloud the ratio of the drags is that of the formula at the mixture's Sauter diameter."""
    mesh, _ = fe_el.periodic_box((1e-2,) * 3, (3, 3, 3))
    air, p = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.2, 1.8e-5), fe_el.Particles(mesh, 2000.0)
    d = np.repeat([1e-3, 2e-3], [40, 10])
    p.insert_in_box((0, 0, 0), (1e-2,) * 3, 50, d, velocity=(0.1, 0, 0), seed=1)
    c = fe_el.Coupling(p, air.velocity, air.pressure, 1.2, 1.8e-5, [fe_el.Drag("beetstra", polydisperse=True)], "explicit",
                       "well_mixed")
    c.to_fluid(1e-5)
    c.to_particles(1e-5)
    y = np.array([1e-3, 2e-3]) / ((d ** 3).sum() / (d ** 2).sum())
    f = [p.force[np.isclose(p.diameter, size), 0].mean() for size in (1e-3, 2e-3)]
    assert f[1] / f[0] == pytest.approx(2 * (y[1] + 0.064 * y[1] ** 3) / (y[0] + 0.064 * y[0] ** 3), rel=1e-10)


def test_time_scales_and_advice():
    """The paper's suspension: tau_p and tau_f of the reference, the explicit limit near 0.025 at dense clusters, and
    advice."""
    law = fe_el.drag_laws.beetstra
    slip = time_scales.homogeneous_slip(150e-6, 1500.0, 1.3, 1.8e-5, 0.1, law)
    assert slip == pytest.approx(0.375337, rel=1e-5)
    re = 1.3 * 0.9 * slip * 150e-6 / 1.8e-5
    assert time_scales.particle_relaxation_time(150e-6, 1500.0, 1.8e-5, 0.1, law, re) == pytest.approx(0.0425487, rel=1e-5)
    assert time_scales.fluid_relaxation_time(150e-6, 1.3, 1.8e-5, 0.1, law, re) == pytest.approx(3.3188e-4, rel=1e-4)
    assert time_scales.fluid_relaxation_time(150e-6, 1.3, 1.8e-5, 0.1) == pytest.approx(8.125e-4, rel=1e-6)
    assert 0.02 < time_scales.explicit_limit(150e-6, 1.3, 1.8e-5, 0.48, law, re) / 8.125e-4 < 0.03
    dense = time_scales.advice(150e-6, 1500.0, 1.3, 1.8e-5, 0.1, 1.0, 1e-3, law, contact_time=1e-5)
    assert dense.scheme == "conservative" and "sub-steps" in dense.sentence
    thin = time_scales.advice(5e-3, 2500.0, 1.3, 1.8e-5, 1e-4, 5.0, 1e-3, law, largest_solid_fraction=1e-3)
    assert thin.scheme == "explicit"
    with pytest.raises(ValueError, match="diameter"):
        time_scales.advice(-1.0, 1500.0, 1.3, 1.8e-5, 0.1, 1.0, 1e-3, law)


@pytest.mark.ranks
def test_a_particle_that_has_crossed_the_seam_is_found_behind_it():
    """Between two renewals of the lists, on any number of slices: the cell holds the wrapped position."""
    length = np.array([0.003, 0.003, 0.012])
    mesh, _ = fe_el.periodic_box(length, (3, 3, 12), slices_along=2)
    beads = fe_el.Particles(mesh, 2500.0)
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(50.0, 0.9, 0.1), skin=2e-4)
    beads.insert_at([[0.0015, 0.0014, 5e-5], [0.0005, 0.0006, 0.006]], 3e-4, velocity=[[0, 0, -0.5], [0, 0, 0]])
    beads.advance(1e-5, contacts)
    beads.advance(1.2e-4, contacts)
    cell, position = beads.located()
    assert all((beads.cells.barycentric[c] @ np.append(x, 1.0)).min() > -1e-9 for c, x in zip(cell, position))
    assert mesh.comm.allreduce(int((position[:, 2] > 0.0119).sum())) == 1
