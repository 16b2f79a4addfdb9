"""Cell means of a fluid's fields: from its own Functions, whatever their elements."""
import numpy as np
import ufl
from dolfinx import fem

from fe_el.compiled.for_each_dimension import D, M, by_dimension
from fe_el.dolfinx_api import dof_table, element_of, scalar_space


class CellMean:
    """Means over the cells of a dolfinx expression (scalar or vector) [its units].

    A DG0 Function is read directly; anything else is integrated with one compiled form per component.
    """

    def __init__(self, mesh, expression, components):
        self.cells, self.components = mesh.topology.index_map(mesh.topology.dim).size_local, components
        self.direct = None
        if isinstance(expression, fem.Function):
            if element_of(expression.function_space) == ("DG", 0):
                self.direct = expression.x.array.reshape(-1, components)[:self.cells]
                return
        space = scalar_space(mesh, "DG", 0)
        w = ufl.TestFunction(space)
        parts = [expression[k] for k in range(components)]
        self.forms = [fem.form(part * w * ufl.dx) for part in parts]
        self.volume = fem.petsc.assemble_vector(fem.form(w * ufl.dx(mesh))).array.copy()

    def __call__(self):
        """(owned cells, components)."""
        if self.direct is not None:
            return self.direct
        return np.column_stack([fem.petsc.assemble_vector(f).array / self.volume for f in self.forms])


@by_dimension
def _slopes(dofs, gradient, values, out):
    """Gradients (cells, d) of a P1 field."""
    for c in range(len(dofs)):
        for k in range(D):
            total = 0.0
            for i in range(M):
                total += gradient[c, i, k] * values[dofs[c, i]]
            out[c, k] = total


class PressureGradientMean:
    """Cell means of grad p: exact and without a form for P1 pressure."""

    def __init__(self, mesh, pressure, barycentric):
        d = mesh.topology.dim
        element = element_of(pressure.function_space) if isinstance(pressure, fem.Function) else None
        n = mesh.topology.index_map(d).size_local
        self.general = None
        if element == ("P", 1):
            self.dofs = np.ascontiguousarray(dof_table(pressure.function_space)[:n].astype(np.int32))
            self.gradient, self.slope, self.values = barycentric[:n], np.empty((n, d)), pressure.x.array
        else:
            self.general = CellMean(mesh, ufl.grad(pressure), d)

    def __call__(self):
        """(owned cells, d) [Pa/m]."""
        if self.general is not None:
            return self.general()
        _slopes(self.dofs, self.gradient, self.values, self.slope)
        return self.slope
