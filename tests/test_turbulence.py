"""Eddy viscosities against the same formulas written with numpy."""
import numpy as np
import pytest

import fe_el


def formula(model, g, width):
    """Eddy viscosity of gradients g[c, i, j] = d u_j / d x_i."""
    s = 0.5 * (g + np.transpose(g, (0, 2, 1)))
    strain = (s * s).sum((1, 2))
    if isinstance(model, fe_el.Smagorinsky):
        return (0.17 * width) ** 2 * np.sqrt(2 * strain)
    if isinstance(model, fe_el.Vreman):
        b = width[:, None, None] ** 2 * np.einsum("cmi,cmj->cij", g, g)
        invariant = 0.5 * (np.einsum("cii->c", b) ** 2 - (b * b).sum((1, 2)))
        return 0.07 * np.sqrt(np.maximum(invariant, 0.0) / (g * g).sum((1, 2)))
    square = np.einsum("cik,ckj->cij", g, g)
    deviator = 0.5 * (square + np.transpose(square, (0, 2, 1)))
    deviator -= np.einsum("cii->c", square)[:, None, None] / 3 * np.eye(g.shape[1])
    size = (deviator * deviator).sum((1, 2))
    return (0.325 * width) ** 2 * size ** 1.5 / (strain ** 2.5 + size ** 1.25)


@pytest.mark.ranks
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("model", [fe_el.Smagorinsky(), fe_el.Vreman(), fe_el.Wale()])
def test_values_are_those_of_the_formula(model, dimension):
    mesh, _ = fe_el.box((1.0, 0.7, 0.4)[:dimension], (4, 5, 3)[:dimension])
    air = fe_el.VolumeAveragedNavierStokes(mesh)
    u = np.random.default_rng(3).normal(size=(air.nodes, dimension))
    gradient = np.einsum("cvi,cvj->cij", air.gradient, u[air.dofs])
    expected = formula(model, gradient, air.volume ** (1 / dimension))
    assert model(air, u) == pytest.approx(expected, rel=1e-11)
    assert not model(air, np.ones_like(u)).max(initial=0.0) > 1e-12
