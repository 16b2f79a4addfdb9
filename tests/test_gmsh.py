"""Meshes from gmsh: what is no mesh for fe_el is refused in a sentence, and the next read works."""
import pytest
from mpi4py import MPI

import fe_el


def write(path, case):
    """Two boxes side by side, or a sheet, with physical groups as users make them; on rank 0."""
    import gmsh
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.4)
    model, occ, dimension = gmsh.model, gmsh.model.occ, 2 if case == "turned" else 3
    if dimension == 2:
        sheet = occ.addRectangle(0, 0, 0, 1, 1)
        occ.rotate([(2, sheet)], 0, 0, 0, 1, 0, 0, 1.5707963267948966)
        occ.synchronize()
        model.addPhysicalGroup(2, [sheet], 10)
    else:
        occ.fragment([(3, occ.addBox(0, 0, 0, 0.5, 1, 1))], [(3, occ.addBox(0.5, 0, 0, 0.5, 1, 1))])
        occ.synchronize()
        volumes = [t for _, t in model.getEntities(3)]
        if case != "none":
            model.addPhysicalGroup(3, volumes[:1] if case == "one" else volumes, 10)
        if case == "two":
            model.addPhysicalGroup(3, volumes[:1], 11)
    model.mesh.generate(dimension)
    gmsh.option.setNumber("Mesh.SaveAll", 1)
    gmsh.write(path)
    gmsh.finalize()


@pytest.mark.ranks
@pytest.mark.parametrize("case, dimension, words", [("two", 3, "in 2 physical groups"), ("one", 3, "in 0 physical groups"),
                                                    ("none", 3, "in 0 physical groups"),
                                                    ("turned", 2, "plane of constant z"),
                                                    ("turned", 3, "cells of type none"),
                                                    ("text", 3, "physical groups|cannot read|cells of")])
def test_what_is_no_mesh_is_refused_and_the_next_is_read(folder, case, dimension, words):
    path = f"{folder}/{case}.msh"
    if MPI.COMM_WORLD.rank == 0:
        if case == "text":
            with open(path, "w") as file:
                file.write("no mesh\n" * 20)
        else:
            write(path, case)
    MPI.COMM_WORLD.barrier()
    with pytest.raises(ValueError, match=words):
        fe_el.read_mesh(path, dimension=dimension)
    mesh, _, tags = fe_el.mesh_geo("meshes/hopper.geo", size=0.02)
    assert mesh.topology.index_map(3).size_global > 100 and len(tags.values) >= 0
