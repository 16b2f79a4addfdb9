"""Distributions of diameters: means, medians and shares, by number and by mass, of single particles and of parcels."""
import numpy as np
import pytest

import fe_el

N = 200_000
SIZES = fe_el.SizeDistribution


def draw(sizes, number=None):
    return sizes.draw(np.random.default_rng(1), N, number)


def test_a_list_has_its_shares():
    d = draw(SIZES.listed([1e-3, 2e-3], [1, 3]))
    assert set(d) == {1e-3, 2e-3} and (d == 2e-3).mean() == pytest.approx(0.75, abs=0.005)
    d = draw(SIZES.listed([1e-3, 2e-3], [1, 1], by="mass"))
    assert (d == 2e-3).mean() == pytest.approx(1 / 9, abs=0.005)
    assert (draw(SIZES.listed(1e-3)) == 1e-3).all()


def test_normal():
    d = draw(SIZES.normal(20e-6, 3e-6))
    assert d.mean() == pytest.approx(20e-6, rel=1e-3) and d.std() == pytest.approx(0.9866 * 3e-6, rel=5e-3)  # cut at 3
    assert d.min() >= 11e-6 and d.max() <= 29e-6


def test_lognormal():
    for by in ("number", "mass"):
        sizes = SIZES.lognormal(20e-6, 1.5, by=by)
        d = draw(sizes)
        weight = np.ones(N) if by == "number" else d ** 3
        order = np.argsort(d)
        share = np.cumsum(weight[order]) / weight.sum()
        assert d[order][np.searchsorted(share, 0.5)] == pytest.approx(20e-6, rel=0.02)
        assert (d ** 3).mean() == pytest.approx(sizes.mean_cube(), rel=0.03)


def test_rosin_rammler_and_sieves():
    """Shares of the mass that are finer than some sizes."""
    d = draw(SIZES.rosin_rammler(50e-6, 3.0, 10e-6, 100e-6))
    table = SIZES.sieves([10e-6, 30e-6, 50e-6, 100e-6], [0.0, 0.2, 0.7, 1.0])
    s = draw(table)
    for at, passing in ((30e-6, 0.2), (50e-6, 0.7), (40e-6, 0.45)):
        curve = 1 - np.exp(-(np.array([10e-6, at, 100e-6]) / 50e-6) ** 3)
        assert (d ** 3)[d < at].sum() / (d ** 3).sum() == pytest.approx((curve[1] - curve[0]) / (curve[2] - curve[0]),
                                                                      abs=0.01)
        assert (s ** 3)[s < at].sum() / (s ** 3).sum() == pytest.approx(passing, abs=0.01)
    assert table.smallest == 10e-6 and table.largest == pytest.approx(100e-6)


def test_parcels_have_the_distribution_of_their_particles():
    """Parcels of equal mass: drawn by mass, and with their numbers as weights they have the particles' mean size."""
    sizes = SIZES.listed([5e-6, 20e-6], [1, 1], by="mass")
    d = draw(sizes, lambda d: 1e-12 / d ** 3)
    assert (d == 5e-6).mean() == pytest.approx(0.5, abs=0.005)
    sizes = SIZES.normal(20e-6, 5e-6)
    d = draw(sizes, lambda d: 1e-12 / d ** 3)
    assert np.average(d, weights=1 / d ** 3) == pytest.approx(draw(sizes).mean(), rel=5e-3)


def test_parcels_have_it_within_a_wide_class_too():
    """One class from 1 to 4 mm, whose particles are uniform in it: parcels of equal mass have the density d^3 (mean 3.208
    mm), those of the same number on both sides of a jump in it are uniform, and an injector draws the same."""
    sizes, number = SIZES([1e-3], [4e-3], [1.0]), lambda d: 1e-9 / d ** 3
    d = draw(sizes, number)
    assert d.mean() == pytest.approx(4 / 5 * (4 ** 5 - 1) / (4 ** 4 - 1) * 1e-3, rel=2e-3)
    assert np.histogram(d, 6, (1e-3, 4e-3), weights=number(d) / number(d).sum())[0] == pytest.approx(1 / 6, rel=0.03)
    d = draw(sizes, lambda d: np.where(d < 2e-3, 10.0, 1.0))
    assert (d < 2e-3).mean() == pytest.approx(1 / 21, rel=0.02)
    mesh, _ = fe_el.box((0.1,) * 3, (2,) * 3)
    p = fe_el.Particles(mesh, 2500.0)
    jet = fe_el.Injector(p, fe_el.DiscSource((0, 0.05, 0.05), (1, 0, 0), 0.02), (1.0, 0, 0), sizes, mass_rate=1.0,
                         number=number)
    jet.advance(0.02)
    assert p.number.sum() * 2500 * np.pi / 6 * sizes.mean_cube() == pytest.approx(p.mass.sum(), rel=0.02)
    assert (p.number @ p.primary_diameter) / p.number.sum() == pytest.approx(2.5e-3, rel=0.02)


@pytest.mark.parametrize("make, words", [
    (lambda: SIZES.listed([1e-3, -1e-3]), "diameter is -0.001"),
    (lambda: SIZES.listed([1e-3], [1, 2]), "shapes"),
    (lambda: SIZES.listed([1e-3], by="volume"), "by 'volume'"),
    (lambda: SIZES.listed([1e-3], [0.0]), "all shares zero"),
    (lambda: SIZES.sieves([1e-3, 2e-3], [0.5, 0.1]), "rising"),
    (lambda: SIZES.normal(1e-3, 0.0), "deviation"),
    (lambda: SIZES.lognormal(1e-3, 0.9), "greater than 1"),
    (lambda: SIZES.rosin_rammler(1e-3, 3.0, 2e-3, 1e-3), "largest must be above")])
def test_bad_distributions_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
