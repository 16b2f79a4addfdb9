"""A fluid of the user's own to compare with: Taylor-Hood elements in UFL, one linear problem a step, solved by MUMPS."""
import mpi4py.MPI  # noqa: F401  # isort: skip (the wheels of dolfinx find their MPI through it)
import numpy as np
import ufl
from dolfinx import fem

from fe_el.dolfinx_api import cells_at, interpolation_points, linear_problem, petsc_vector, taylor_hood_space, vector_space

DIRECT = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
# theta, and w as parts of u_1 and u_2
CRANK_NICOLSON, FIRST_STEP, EULER = (0.5, 1.5, -0.5), (0.5, 1.0, 0.0), (1.0, 1.0, 0.0)


class TaylorHood:
    """Incompressible flow in a closed domain on one rank: velocity P2, pressure P1.

        rho ((u - u_1) / dt + w . grad m + (div w / 2) m) + grad p - mu lap m - rho gamma grad div u = 0,    div u = 0

    u_1 and u_2 are the velocities one and two steps ago and m = theta u + (1 - theta) u_1. Crank-Nicolson with the
    convecting velocity w = (3 u_1 - u_2) / 2 of the middle of the step, or implicit Euler with w = u_1. Half of div w keeps
    the energy from growing at any step (Temam 1968); gamma makes the error of the pressure small in the velocity (Olshanskii
    2002). Explicit convection is that of u_1 and u_2 extrapolated in the same way; its steps are bounded by the Courant
    number, but the matrix stays the same and is factorised once.

    Args:
        mesh: dolfinx mesh.
        density (float): rho [kg/m^3].
        viscosity (float): mu [Pa s].
        walls: list of (facets, velocity) with local facet numbers and d numbers [m/s]; where they meet the last one holds.
            Normal velocities must add up to no flow.
        time_order (int): 2, or 1 for a march to steady state.
        grad_div (float): gamma, of the order of a speed times a length [m^2/s].
        explicit (bool): convection is explicit.
    """

    def __init__(self, mesh, density, viscosity, walls=(), time_order=2, grad_div=1.0, explicit=False):
        self.mesh, self.time_order, self.explicit, self.step, self.matrix_of = mesh, time_order, explicit, 0, None
        space = taylor_hood_space(mesh)
        self.new, self.old, self.older = fem.Function(space), fem.Function(space), fem.Function(space)
        rho, mu, gamma, self.dt = (fem.Constant(mesh, float(c)) for c in (density, viscosity, grad_div, 1.0))
        self.weights = theta, part_1, part_2 = [fem.Constant(mesh, c) for c in EULER]
        (u, p), (v, q) = ufl.TrialFunctions(space), ufl.TestFunctions(space)
        u1, u2 = ufl.split(self.old)[0], ufl.split(self.older)[0]
        m = theta * u + (1 - theta) * u1
        by = lambda w, u: ufl.dot(w, ufl.nabla_grad(u)) + ufl.div(w) / 2 * u
        convection = part_1 * by(u1, u1) + part_2 * by(u2, u2) if explicit else by(part_1 * u1 + part_2 * u2, m)
        form = (rho * ufl.inner((u - u1) / self.dt + convection,
                                v) + mu * ufl.inner(ufl.grad(m), ufl.grad(v)) - p * ufl.div(v)
                + rho * gamma * ufl.div(u) * ufl.div(v) - q * ufl.div(u)) * ufl.dx
        a, L = ufl.system(form)
        self.problem = linear_problem(a, L, self._conditions(space, walls), self.new, DIRECT)
        self.cell_velocity = fem.Function(vector_space(mesh, "DG", 0))
        self.at_centres = fem.Expression(self.new.sub(0), interpolation_points(self.cell_velocity.function_space))

    def _conditions(self, space, walls):
        """Velocities of the walls, and one pressure, which a closed domain leaves open."""
        velocity, _ = space.sub(0).collapse()
        pressure, in_mixed = space.sub(1).collapse()
        pinned = [np.ravel(in_mixed)[:1].astype(np.int32), np.zeros(1, np.int32)]
        conditions = [fem.dirichletbc(fem.Function(pressure), pinned, space.sub(1))]
        for facets, value in walls:
            prescribed = fem.Function(velocity)
            prescribed.x.array.reshape(-1, len(value))[:] = value
            dofs = fem.locate_dofs_topological((space.sub(0), velocity), self.mesh.topology.dim - 1, facets)
            conditions.append(fem.dirichletbc(prescribed, dofs, space.sub(0)))
        return conditions

    def set_initial_velocity(self, value):
        """Velocity at the start: a function (time, points (points, 3)) -> (points, d)."""
        self.new.sub(0).interpolate(lambda x: value(0.0, x.T).T)

    def advance(self, dt):
        """Advance by ``dt`` [s], which is best the same at every step."""
        self.older.x.array[:], self.old.x.array[:] = self.old.x.array, self.new.x.array
        self.dt.value = dt
        kind = EULER if self.time_order == 1 else CRANK_NICOLSON if self.step else FIRST_STEP
        for weight, value in zip(self.weights, kind):
            weight.value = value
        if self.explicit and self.matrix_of == (dt, kind[0]):
            self._solve_with_the_factors()
        else:
            self.problem.solve()
        self.step, self.matrix_of = self.step + 1, (dt, kind[0])

    def _solve_with_the_factors(self):
        """Solve for a new right-hand side."""
        problem = self.problem
        problem.b.set(0.0)
        fem.petsc.assemble_vector(problem.b, problem.L)
        fem.petsc.apply_lifting(problem.b, [problem.a], bcs=[problem.bcs])
        fem.petsc.set_bc(problem.b, problem.bcs)
        problem.solver.solve(problem.b, petsc_vector(self.new))

    def at_cells(self):
        """Velocity (cells, d) at the centres of the cells."""
        self.cell_velocity.interpolate(self.at_centres)
        return self.cell_velocity.x.array.reshape(-1, self.mesh.topology.dim)

    def at_points(self, points):
        """Velocity (points, d) at points (points, 3)."""
        return self.new.sub(0).eval(points, cells_at(self.mesh, points))
