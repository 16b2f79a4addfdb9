"""Overlaps of spheres and cells by two ways: many spheres at once where each is in few cells, and one by one."""
import dolfinx
import numba
import numpy as np
import pytest
from mpi4py import MPI

import fe_el
from fe_el.compiled.borrowed import borrowed
from fe_el.coupling.overlap import NEGLIGIBLE, OverlapVolume, cell_records, scratch_for
from fe_el.coupling.sphere_cuts import U, inwards, place_edges, take_edges
from fe_el.coupling.sphere_rooms import LAST
from fe_el.coupling.sphere_walk import keep_walk, walk_through


@numba.njit
def _one_by_one(cells, slot, notes, spheres, start, index, weight):
    cells, notes = borrowed((cells, notes))
    cell, position, radius = spheres
    for i in range(len(cell)):
        number, x = U(start[i]), position[i]
        index[number], weight[number] = cell[i], 1.0
        inwards(cells, U(cell[i]), x[0], x[1], x[2], radius[i], notes.centre, U(0))
        known, edges = walk_through(cells, slot, U(500), number, index, weight, notes)
        place_edges(cells, notes, edges)
        take_edges(notes, edges, weight)
        start[i + 1] = keep_walk(known, number, NEGLIGIBLE, index, weight)


def _matrix(start, cell, weight, cells):
    out = np.zeros((len(start) - 1, cells))
    np.add.at(out, (np.repeat(np.arange(len(start) - 1), np.diff(start)), cell), weight)
    return out


@pytest.mark.parametrize("kind", ["walls", "periodic", "flat"])
def test_shares_are_the_same_whether_spheres_are_taken_at_once_or_one_by_one(kind):
    if kind == "periodic":
        mesh, _ = fe_el.periodic_box((1.0, 1.0, 1.0), (4, 4, 4))
    elif kind == "flat":
        mesh = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, 6, 6)
    else:
        mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 4, 4, 4)
    particles, some = fe_el.Particles(mesh, 2500.0), np.random.default_rng(3)
    position = some.random((600, 3)) * ([1, 1, 0] if kind == "flat" else 1)
    particles.insert_at(position, 10 ** some.uniform(-2.5, -0.5, 600))
    cells, spheres = particles.cells, (particles.cell, particles.position, 0.5 * particles.diameter)
    mapping, number = OverlapVolume(), len(particles.cells.volume)
    mapping.prepare(cells, *spheres)
    start, index, weight = np.zeros(601, np.int64), np.empty(300_000, np.int32), np.empty(300_000)
    _one_by_one(cell_records(cells), np.full(number, -1, np.int32), scratch_for(500)[1], spheres, start, index, weight)
    few = np.diff(mapping.start) <= int(LAST)
    assert 100 < few.sum() < 600
    difference = _matrix(mapping.start, mapping.cell, mapping.weight, number) - _matrix(start, index[:start[-1]],
                                                                                         weight[:start[-1]], number)
    assert np.abs(difference).max() < 1e-12
