"""Contacts against published verification cases and analytic results."""
import numpy as np
import pytest

import fe_el


def scene(diameter, density, position, velocity, law, walls=None, gravity=(0, 0, 0), steps=50, size=1.0, **kind):
    mesh, _ = fe_el.box((size,) * 3, (1, 1, 1))
    p = fe_el.Particles(mesh, density, gravity)
    p.insert_at(position, diameter, velocity=velocity, **kind)
    return p, fe_el.Contacts(p, law, walls, steps_per_contact=steps)


FLOOR = fe_el.PlaneWall((0, 0, 0), (0, 0, 1))


@pytest.mark.parametrize("restitution, stiffness", [(0.9, 1e4), (0.6, 5e4), (1.0, 1e5)])
def test_free_fall_and_rebound(restitution, stiffness):
    """MFiX DEM01: d 0.2 m, rho 2600, from 0.5 m: first contact at 0.2856174 s; then the damped oscillator's solution."""
    g, d, m = 9.80665, 0.2, 2600 * np.pi / 6 * 0.2 ** 3
    law = fe_el.LinearSpringDashpot(stiffness, restitution, 0.0)
    p, c = scene(d, 2600.0, [[0.5, 0.5, 0.5]], 0.0, law, FLOOR, (0, 0, -g), steps=400)
    first = np.sqrt(2 * (0.5 - 0.1) / g)
    assert first == pytest.approx(0.2856174, abs=1e-7)
    p.advance(first * 0.999999, None)
    before = p.velocity[0, 2]
    # damped oscillator with gravity from first contact on, until the overlap is gone
    w0, zeta = np.sqrt(stiffness / m), np.abs(np.log(restitution)) / np.hypot(np.pi, np.log(restitution))
    wd, still = w0 * np.sqrt(1 - zeta ** 2), g / w0 ** 2
    t = np.linspace(0, 1.3 * np.pi / wd, 200001)
    a, b = -still, (-before - zeta * w0 * still) / wd
    overlap = still + np.exp(-zeta * w0 * t) * (a * np.cos(wd * t) + b * np.sin(wd * t))
    leaves = np.flatnonzero((overlap[1:] <= 0) & (t[1:] > 0.3 * np.pi / wd))[0] + 1
    speed = -np.gradient(overlap, t)[leaves]
    if (restitution, stiffness) == (0.9, 1e4):
        assert t[leaves] == pytest.approx(0.1118175, rel=1e-3) and speed == pytest.approx(2.4754432, rel=1e-3)
    steps = int(t[leaves] * 1.05 / 1e-3) + 1
    for _ in range(steps):
        p.advance(t[leaves] * 1.05 / steps, c)
    rebound = p.velocity[0, 2] + g * 0.05 * t[leaves]
    assert rebound == pytest.approx(speed, rel=2e-3)


@pytest.mark.parametrize("restitution", [0.6, 0.8, 1.0])
def test_bounce_heights(restitution):
    """MFiX DEM02: the height after k bounces is r + (h0 - r) e^(2k) for hard spheres; stiff ones come close."""
    law = fe_el.LinearSpringDashpot(5e6, restitution, 0.0)
    p, c = scene(0.2, 2600.0, [[0.5, 0.5, 0.5]], 0.0, law, FLOOR, (0, 0, -9.80665), steps=60)
    heights, falling, rose = [], False, 0.0
    for _ in range(1400):
        p.advance(1e-3, c)
        v = p.velocity[0, 2]
        if falling and v > 0:
            falling, rose = False, 0.0
        if not falling and v <= 0:
            if rose:
                heights.append(rose)
            falling = True
        rose = max(rose, p.position[0, 2]) if v > 0 else rose
    assert len(heights) >= 2
    for k, height in enumerate(heights[:3], start=1):
        assert height == pytest.approx(0.1 + 0.4 * restitution ** (2 * k), abs=0.004)


@pytest.mark.parametrize("friction", [0.2, 0.5, 1.0])
def test_slipping_sphere_starts_to_roll(friction):
    """MFiX DEM04: rolling begins at t = 2 u0 / (7 mu g) with u = 5/7 u0 = w r."""
    g, u0, d = 9.80665, 2.0, 0.02
    m, k = 2600 * np.pi / 6 * d ** 3, 1e5
    p, c = scene(d, 2600.0, [[0.1, 0.5, d / 2 - m * g / k]], (u0, 0, 0), fe_el.LinearSpringDashpot(k, 0.9, friction), FLOOR,
                 (0, 0, -g), size=2.0)
    times, slip = [], []
    for _ in range(400):
        p.advance(2 * u0 / (7 * friction * g) / 200, c)
        times.append(p.step * 2 * u0 / (7 * friction * g) / 200)
        slip.append(p.velocity[0, 0] - p.angular_velocity[0, 1] * d / 2)
    start = times[int(np.flatnonzero(np.abs(slip) < 0.005 * u0)[0])]
    assert start * friction * g / u0 == pytest.approx(2 / 7, abs=0.003)
    assert p.velocity[0, 0] / u0 == pytest.approx(5 / 7, abs=2e-4)
    assert p.angular_velocity[0, 1] * d / 2 / u0 == pytest.approx(5 / 7, abs=2e-4)


def oblique(angle, law, speed=3.9, d=5e-3, density=4000.0):
    """Velocity and rotation after a sphere hits a plane at ``angle`` from the normal."""
    t = np.radians(angle)
    p, c = scene(d, density, [[0.5, 0.5, d / 2 * (1 + 1e-6)]], (speed * np.sin(t), 0, -speed * np.cos(t)), law, FLOOR,
                 steps=150)
    duration = law.contact_time(p.mass[0], d / 2, speed * np.cos(t))
    for _ in range(3):
        p.advance(0.6 * duration, c)
    return p.velocity[0], p.angular_velocity[0]


@pytest.mark.parametrize("name, law", [("mfix_linear", fe_el.LinearSpringDashpot(1.72e7, 1.0, 0.092, 1.48 / 1.72)),
                                       ("mfix_hertzian", fe_el.HertzMindlin(3.8e11, 0.23, 1.0, 0.092))])
def test_oblique_impact(reference, name, law):
    """MFiX DEM05: rebound angle of aluminium oxide spheres (Kharaz et al. 2001) at every angle of the suite."""
    rows = [r for r in reference("mfix_dem05_oblique.csv") if r["quantity"] == "ALPHA" and r["set"] == name]
    assert len(rows) > 25
    for row in rows:
        v, _w = oblique(row["impact_angle_deg"], law)
        rebound = np.degrees(np.arctan2(v[0], v[2]))
        assert rebound == pytest.approx(row["value_particle_wall"], abs=0.12)
        if row["impact_angle_deg"] > 32:  # slides throughout: tan(rebound) = tan(impact) - mu (1 + e), exactly
            assert np.tan(np.radians(rebound)) == pytest.approx(np.tan(np.radians(row["impact_angle_deg"])) - 2 * 0.092,
                                                                abs=1e-3)


def test_oblique_impact_against_the_experiment(reference):
    """Chung & Ooi test 4: tangential restitution, rotation and rebound angle against the digitised measurements."""
    law = fe_el.HertzMindlin(3.8e11, 0.23, 0.98, 0.092)
    columns = {"tangential_restitution": 0.05, "omega_rad_s": 40.0, "contact_point_rebound_angle_deg": 4.0}
    seen = 0
    for row in reference("chung_ooi2011_digitised.csv"):
        if row["test"] != 4 or row["y_name"] not in columns or row["x"] < 2:
            continue
        v, w = oblique(row["x"], law)
        t = np.radians(row["x"])
        value = {"tangential_restitution": v[0] / (3.9 * np.sin(t)), "omega_rad_s": -abs(w[1]),
                 "contact_point_rebound_angle_deg": np.degrees(np.arctan2(v[0] - w[1] * 2.5e-3, v[2]))}[row["y_name"]]
        assert value == pytest.approx(row["y"], abs=columns[row["y_name"]]), row
        seen += 1
    assert seen > 25


@pytest.mark.parametrize("index", [0, 1, 2])
def test_hertz_collision(reference, index):
    """Chung & Ooi tests 1 and 2: largest force, approach and duration of an elastic Hertz collision."""
    row = reference("chung_ooi_hertz_analytic.csv")[index]
    d, v = 2 * row["R_m"], row["relative_velocity_m_s"]
    law = fe_el.HertzMindlin(row["E_Pa"], row["nu"], 1.0, 0.0)
    if row["test"] == 1:
        p, c = scene(d, row["rho"], [[0.5 - d / 2 * (1 + 1e-9), 0.5, 0.5], [0.5 + d / 2 * (1 + 1e-9), 0.5, 0.5]],
                     [[v / 2, 0, 0], [-v / 2, 0, 0]], law)
    else:  # against a rigid plane the plane's own softness is absent: E* = E / (1 - nu^2) for a rigid wall
        stiff = fe_el.HertzMindlin(2 * row["E_Pa"], row["nu"], 1.0, 0.0)
        p, c = scene(d, row["rho"], [[0.5, 0.5, d / 2 * (1 + 1e-9)]], (0, 0, -v), stiff, FLOOR)
    duration = row["contact_time_s"]
    force, time = [], []
    for k in range(240):
        p.advance(duration / 200, c)
        force.append(np.abs(p.contact_force).max())
        time.append((k + 1) * duration / 200)
    touching = np.array(force) > 0
    assert max(force) == pytest.approx(row["F_max_N"], rel=2e-3)
    assert touching.sum() / 200 == pytest.approx(1.0, abs=0.01)
    assert c.largest_overlap * d == pytest.approx(row["delta_max_total_approach_m"], rel=2e-3)
