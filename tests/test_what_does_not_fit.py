"""Calls that each are right and do not go together: a sentence says so, in place of a text of numpy or a wrong number."""
import numpy as np
import pytest

import fe_el


def scene(**law):
    """Beads in gas in a box with walls, their contacts and coupling, and the tags."""
    mesh, tags = fe_el.box((0.01,) * 3, (3, 3, 3))
    beads = fe_el.Particles(mesh, 2500.0, (0, 0, -9.81))
    beads.insert_in_box((1e-3,) * 3, (9e-3, 9e-3, 5e-3), 40, 1e-3, seed=1, without_overlap=True)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, gravity=(0, 0, -9.81))
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(200.0, 0.5, 0.3, **law), (tags, (1, 2, 3, 4, 5, 6)), None, 12)
    return tags, beads, air, contacts, fe_el.Coupling.of(air, beads, [fe_el.Drag("beetstra")])


def test_particles_that_come_between_fluid_and_answer():
    _, beads, air, _, coupling = scene()
    coupling.to_fluid(1e-4)
    air.advance(1e-4, coupling.fields)
    beads.insert_at([(5e-3, 5e-3, 8e-3)], 1e-3)
    with pytest.raises(RuntimeError, match=r"Particles came, left or changed rank since they were mapped; call to_fluid"):
        coupling.to_particles(1e-4)
    coupling.to_fluid(1e-4)
    coupling.to_particles(1e-4)


def test_a_wall_that_is_given_twice():
    """Its force would be that of its second place in the list: none."""
    tags, beads, *_ = scene()
    wall = fe_el.FacetWalls(tags, 5)
    with pytest.raises(ValueError, match="more than once; give each wall once"):
        fe_el.Contacts(beads, fe_el.LinearSpringDashpot(200.0, 0.5, 0.3), [wall, wall])


def test_contacts_of_a_law_without_rolling_friction(tmp_path):
    """Springs of both kinds have other numbers."""
    tags, beads, _, contacts, _ = scene()
    for _ in range(40):
        beads.advance(1e-3, contacts)
    assert contacts.touching
    fe_el.save_checkpoint(tmp_path / "a.h5", beads, contacts)
    *_, rolling, _ = scene(rolling=fe_el.RollingFriction(0.1))
    with pytest.raises(ValueError, match="the checkpoint had no rolling friction"):
        fe_el.load_checkpoint(tmp_path / "a.h5", rolling.particles, rolling)


def test_observers_of_something_else(tmp_path):
    """Slabs and points are those of the checkpoint."""
    _, beads, air, _, _ = scene()

    def size(p):
        return p.diameter
    profile, probe = fe_el.ParticleProfile(beads, [0, 0.5, 1.0], size), fe_el.Probe([air.pressure], [(5e-3,) * 3])
    profile.add(1.0)
    probe.record(1.0)
    fe_el.save_checkpoint(tmp_path / "a.h5", profile)
    fe_el.save_checkpoint(tmp_path / "b.h5", probe)
    with pytest.raises(ValueError, match="has 3 slabs, that of the checkpoint had 2"):
        fe_el.load_checkpoint(tmp_path / "a.h5", fe_el.ParticleProfile(beads, [0, 0.2, 0.5, 1.0], size))
    for others in (fe_el.Probe([air.pressure, air.velocity], [(5e-3,) * 3]), fe_el.Probe([air.pressure], [(5e-3,) * 3] * 2)):
        with pytest.raises(ValueError, match="other functions or another number of points"):
            fe_el.load_checkpoint(tmp_path / "b.h5", others)
    same = fe_el.Probe([air.pressure], [(5e-3,) * 3])
    fe_el.load_checkpoint(tmp_path / "b.h5", same)
    assert len(same.rows) == 1 and np.array_equal(same.rows[0][1], probe.rows[0][1])


def test_beads_that_no_inlet_lets_in():
    """They would wait for ever, and nobody would know why; one that is in the way of another is no such case."""
    mesh, tags = fe_el.box((0.01,) * 3, (3, 3, 3))
    beads = fe_el.Particles(mesh, 2500.0)
    inlet = fe_el.Inlet(beads, tags, 6, 1.0, 2e-2, (0, 0, -1.0))
    with pytest.warns(RuntimeWarning, match="A particle of diameter 0.02 m found no place at the inlet in 100 tries"):
        assert inlet.advance(1.0) == 0
    filled = fe_el.Inlet(beads, tags, 6, 1.0, 5e-3, (0, 0, -1.0))
    filled.advance(0.1)
    assert beads.total_number and filled.waiting > 0
