"""Meshes from gmsh: what is no mesh for fe_el is refused in a sentence, and the next read works."""
import sys

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


@pytest.mark.ranks
def test_groups_by_name_and_a_mesh_in_millimetres(folder):
    """Names of gmsh stand for numbers wherever groups are taken; a cube of 20 mm becomes one of 0.02 m."""
    path = f"{folder}/named.msh"
    if MPI.COMM_WORLD.rank == 0:
        import gmsh
        gmsh.initialize()
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 8)
        model = gmsh.model
        cube = model.occ.addBox(0, 0, 0, 20, 20, 20)
        model.occ.synchronize()
        model.addPhysicalGroup(3, [cube], 10)
        for number, name, sides in ((31, "INLET", [5]), (32, "OUTLET", [6]), (33, "WALL", [1, 2, 3, 4])):
            model.setPhysicalName(2, model.addPhysicalGroup(2, sides, number), name)
        model.mesh.generate(3)
        gmsh.write(path)
        gmsh.finalize()
    MPI.COMM_WORLD.barrier()
    mesh, _, tags = fe_el.read_mesh(path, scale=1e-3)
    assert tags.names == {"INLET": 31, "OUTLET": 32, "WALL": 33}
    air, beads = fe_el.VolumeAveragedNavierStokes(mesh, tags), fe_el.Particles(mesh, 2500.0, (0, 0, -9.81))
    air.set_velocity("INLET", (0, 0, 0.5))
    air.set_pressure("OUTLET")
    air.set_no_slip(("WALL",))
    heat = fe_el.Scalar(air, 1e-5)
    heat.set_inflow("INLET", 1.0)
    air.advance(1e-3)
    heat.advance(1e-3)
    assert air.comm.allreduce(air.volume.sum()) == pytest.approx(8e-6)
    assert air.boundary_force("WALL")[0] == pytest.approx(air.boundary_force(33)[0])
    inlet = fe_el.Inlet(beads, tags, "OUTLET", 0.01, 1e-3, (0, 0, -0.3))
    beads.remove_at(tags, ["INLET"])
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(100.0, 0.5, 0.3), (tags, ("WALL", 31)))
    for _ in range(5):
        inlet.advance(1e-2)
        beads.advance(1e-3, contacts)
    assert beads.total_number == inlet.inserted > 5
    for bad, words in (("LID", "LID.*names.*INLET"), (1.5, "whole number"), ((), "at least one"), (None, "whole number")):
        for call in (air.set_slip, lambda group: fe_el.Contacts(beads, contacts.law, (tags, group))):
            with pytest.raises(ValueError, match=words):
                call(bad)
    with pytest.raises(ValueError, match="scale"):
        fe_el.read_mesh(path, scale=0.0)


@pytest.mark.parametrize("module, said", [("raise OSError('libGLU.so.1: cannot open shared object file')", "libGLU.so.1"),
                                          ("raise ModuleNotFoundError('No module named gmsh')", "No module named gmsh")])
def test_a_gmsh_that_cannot_be_loaded_is_said_in_one_sentence(tmp_path, monkeypatch, module, said):
    """As its wheel on a machine without the libraries of a screen; with what to install."""
    (tmp_path / "gmsh.py").write_text(module)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "gmsh", raising=False)
    for read in (fe_el.read_mesh, fe_el.mesh_geo):
        with pytest.raises(ImportError, match=f"cannot be loaded .*{said}.*; install .*apt-get install libgl1"):
            read(tmp_path / "a.msh")
