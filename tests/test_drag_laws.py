"""Drag laws against evaluated formulas and published check values."""
import numpy as np
import pytest

import fe_el
from fe_el import drag_laws

COLUMNS = {"Beetstra2007_drag_only": drag_laws.beetstra, "WenYu_drag_only": drag_laws.wen_yu,
           "Ergun_drag_only": drag_laws.ergun,
           "Gidaspow_drag_only": drag_laws.gidaspow, "DiFelice_drag_only": drag_laws.di_felice}


@pytest.mark.parametrize("law, solid_fraction, reynolds, expected", [
    (drag_laws.beetstra, 0.1, 100, 8.5537), (drag_laws.beetstra, 0.3, 10, 8.2794), (drag_laws.beetstra, 0.45, 100, 39.0601),
    (drag_laws.beetstra, 0.5, 0, 20.5152), (drag_laws.wen_yu, 0.3, 100, 16.7223), (drag_laws.ergun, 0.4, 0, 9.2593)])
def test_published_values(law, solid_fraction, reynolds, expected):
    assert law(np.array([solid_fraction]), np.array([float(reynolds)]))[0] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("column", COLUMNS)
def test_table(reference, column):
    """Every row of the reference table, Re from 1e-6 up."""
    rows = reference("drag_F_table.csv")
    s = np.array([r["phi"] for r in rows])
    re = np.array([r["Re=rho*eps*|du|*d/mu"] for r in rows])
    expected = np.array([r[column] for r in rows])
    assert np.allclose(COLUMNS[column](s, re), expected, rtol=2e-7)


@pytest.mark.parametrize("law", drag_laws.LAWS.values())
def test_finite_stokes_limit(law):
    """At Reynolds number zero every law is finite, and positive once there are other spheres."""
    drag = law(np.array([1e-3, 0.3, 0.6]), np.zeros(3))
    assert np.isfinite(drag).all() and (drag > 0).all()


@pytest.mark.parametrize("law", [drag_laws.tang, drag_laws.tenneti, drag_laws.koch_hill, drag_laws.beetstra])
def test_single_sphere_limit(law):
    """Few spheres in creeping flow: Stokes."""
    assert law(np.array([1e-9]), np.zeros(1))[0] == pytest.approx(1.0, abs=1e-3)


def test_gidaspow_switches_at_a_void_fraction_of_four_fifths():
    s, re = np.array([0.19, 0.21]), np.array([50.0, 50.0])
    assert np.allclose(drag_laws.gidaspow(s, re), [drag_laws.wen_yu(s, re)[0], drag_laws.ergun(s, re)[1]])


def test_ergun_law_gives_erguns_equation():
    """-dp/dx = beta u / phi with d 1 mm, mu 1.8e-5, rho 1.2, void fraction 0.4, U 0.5 m/s: 12515.6 Pa/m."""
    phi, speed = 0.4, 0.5
    beta = fe_el.Drag("ergun").coefficient(np.array([1 - phi]), np.array([speed / phi]), np.array([1e-3]), 1.2, 1.8e-5)[0]
    assert beta * (1 - phi) * speed / phi ** 2 == pytest.approx(12515.625, rel=1e-6)


def test_polydisperse_correction():
    """F of a sphere of diameter d in a mixture of Sauter diameter d32 is F(d32) (y + 0.064 y^3), y = d / d32."""
    s, slip, d = np.full(2, 0.3), np.full(2, 0.2), np.array([1e-3, 2e-3])
    sauter = np.full(2, 1.5e-3)
    beta = fe_el.Drag("beetstra", polydisperse=True).coefficient(s, slip, d, 1.2, 1.8e-5, sauter)
    drag = drag_laws.beetstra(s, 1.2 * 0.7 * slip * 1.5e-3 / 1.8e-5)
    y = d / 1.5e-3
    assert np.allclose(beta, 18 * 1.8e-5 * 0.7 * drag * (y + 0.064 * y ** 3) / d ** 2, rtol=1e-14)


def test_unknown_law_is_refused():
    with pytest.raises(ValueError, match="beetstra"):
        fe_el.Drag("betsra")
    with pytest.raises(ValueError, match="solid_fraction, reynolds"):
        fe_el.Drag(lambda reynolds: 1.0)
