"""Drag laws against evaluated formulas and published check values."""
import numpy as np
import pytest

from fe_el import drag_laws


@pytest.mark.parametrize("law, solid_fraction, reynolds, expected", [
    (drag_laws.beetstra, 0.1, 100, 8.5537), (drag_laws.beetstra, 0.3, 10, 8.2794), (drag_laws.beetstra, 0.45, 100, 39.0601),
    (drag_laws.beetstra, 0.5, 0, 20.5152), (drag_laws.wen_yu, 0.3, 100, 16.7223), (drag_laws.ergun, 0.4, 0, 9.2593)])
def test_published_values(law, solid_fraction, reynolds, expected):
    assert law(np.array([solid_fraction]), np.array([float(reynolds)]))[0] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("law", drag_laws.LAWS.values())
def test_finite_stokes_limit(law):
    """At Reynolds number zero every law is finite, and positive once there are other spheres."""
    drag = law(np.array([1e-3, 0.3, 0.6]), np.zeros(3))
    assert np.isfinite(drag).all() and (drag > 0).all()


def test_gidaspow_switches_at_a_void_fraction_of_four_fifths():
    s, re = np.array([0.19, 0.21]), np.array([50.0, 50.0])
    assert np.allclose(drag_laws.gidaspow(s, re), [drag_laws.wen_yu(s, re)[0], drag_laws.ergun(s, re)[1]])
