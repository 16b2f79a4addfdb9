"""Krylov solvers that reuse their preconditioner while it is good."""
from functools import lru_cache

import numpy as np
from petsc4py import PETSc

from fe_el.nodes.nodal_kernels import finite
from fe_el.parallel.messages import largest, ranks_of


class SolverDiverged(RuntimeError):
    """A linear solver did not converge."""


# tried in this order when the chosen method fails; the first only for symmetric matrices, the last for regular ones
FALLBACKS = (("fgmres", "hypre"), ("fgmres", "asm"), ("preonly", "lu"))

TRUCE = 50  # solves in which a method that has failed is not tried again


@lru_cache(None)
def is_there(preconditioner):
    """Whether this PETSc was built with a preconditioner."""
    trial = PETSc.PC().create(PETSc.COMM_SELF)
    try:
        trial.setType(preconditioner)
        return True
    except PETSc.Error:
        return False
    finally:
        trial.destroy()


class LinearSolver:
    """Krylov solver of one matrix.

    Args:
        matrix: PETSc matrix.
        name (str): what is solved, for errors and the PETSc options prefix ``name_``.
        method, preconditioner (str): PETSc types.
        tolerance (float): relative residual.
        constant_nullspace (bool): whether the constant is in the kernel.

    Attributes:
        iterations (int): of the last solve.
        fallbacks (int): solves that needed a stronger method than the chosen one.
    """

    def __init__(self, matrix, name, method, preconditioner, tolerance, constant_nullspace=False):
        self.matrix, self.name, self.fresh, self.best = matrix, name, False, None
        self.ksp = PETSc.KSP().create(matrix.comm)
        self.ksp.setOptionsPrefix(name + "_")
        self.ksp.setOperators(matrix)
        self.ksp.setType(method)
        self.ksp.getPC().setType(preconditioner)
        if preconditioner == "cholesky":
            self.ksp.getPC().setFactorOrdering("nd")  # fills in least
        self.ksp.setTolerances(rtol=tolerance, atol=1e-300, max_it=500)
        self.ksp.setInitialGuessNonzero(True)
        if method != "cg":
            self.ksp.setPCSide(PETSc.PC.Side.RIGHT)
        self.ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)  # the true residual
        self.nullspace = PETSc.NullSpace().create(constant=True, comm=matrix.comm) if constant_nullspace else None
        if self.nullspace:
            matrix.setNullSpace(self.nullspace)
        self.ksp.setConvergenceHistory(reset=True)
        self._read_options(self.ksp)
        self.x, self.b = matrix.createVecs()
        self.iterations, self.fallbacks, self.resort, self.ranks = 0, 0, 0, ranks_of(matrix.comm.tompi4py())
        self.rough = None

    def free(self):
        """Release the memory of the solver and its matrix, which nobody may use any more. Collective."""
        for thing in (self.ksp, self.rough, self.x, self.b, self.matrix):
            if thing is not None:
                thing.destroy()

    def _read_options(self, ksp):
        """PETSc's options for a solver; hypre has no Gaussian elimination for the coarsest level of a singular matrix."""
        options, key = PETSc.Options(), ksp.getOptionsPrefix() + "pc_hypre_boomeramg_relax_type_coarse"
        smooth = self.nullspace is not None and not options.hasName(key)
        if smooth:
            options[key] = "symmetric-SOR/Jacobi"
        ksp.setFromOptions()
        if smooth:
            options.delValue(key)

    def new_values(self):
        """Say that the matrix has new values: the preconditioner is renewed once it costs twice the iterations."""
        stale = self.best is not None and self.iterations > 2 * self.best + 2
        self.ksp.getPC().setReusePreconditioner(self.best is not None and not stale)
        self.ksp.setOperators(self.matrix)
        if stale:
            self.best = None

    def solve(self, rhs, guess):
        """Solve for owned entries; what fails is tried again with a fresh preconditioner, then with stronger methods.

        Raises:
            SolverDiverged: with the reason and the residual history of the last try.
        """
        self.b.array[:] = rhs
        if self.nullspace:
            self.nullspace.remove(self.b)
        self.resort -= self.resort > 0
        if not self.resort and self._try(self.ksp, guess):
            self.best = self.iterations if self.best is None else self.best
            return self.x.array
        if not self.resort and self.best is not None:
            self.ksp.getPC().setReusePreconditioner(False)
            self.ksp.setOperators(self.matrix)
            self.best = None
            if self._try(self.ksp, guess):
                self.best = self.iterations
                return self.x.array
        for method, preconditioner in FALLBACKS[self.ksp.getType() != "cg":3 - bool(self.nullspace)]:
            ksp = self._fallback(method, preconditioner)
            done = self._try(ksp, np.zeros_like(guess))
            reason, history = ksp.getConvergedReason(), ksp.getConvergenceHistory()
            ksp.destroy()
            if done:
                self.fallbacks, self.resort = self.fallbacks + 1, self.resort or TRUCE
                return self.x.array
        if self.resort:  # the chosen method was left out
            self.resort = 0
            return self.solve(rhs, guess)
        history = ", ".join(f"{r:.3g}" for r in history[-6:])
        raise SolverDiverged(f"The {self.name} solve failed (PETSc reason {reason}) after {self.iterations} "
                             f"iterations for a right-hand side of {self.b.norm():g}; last residuals {history}. Use a "
                             f"smaller "
                             "time step or check the void fraction and drag fields.")

    def roughly(self, rhs, tolerance):
        """A solution for owned entries to a relative residual ``tolerance``, as far as 100 iterations come. Collective.

        By minimal residuals: where the method of exact solutions is (BiCGStab) the round-off of another order of nodes
        grows to a thousandth of the tolerance in fifty iterations.
        """
        if self.rough is None:
            self.rough = PETSc.KSP().create(self.matrix.comm)
            self.rough.setOptionsPrefix(self.name + "_roughly_")
            self.rough.setType("gmres")
            self.rough.setGMRESRestart(100)
            self.rough.getPC().setType(self.ksp.getPC().getType())
            self.rough.setPCSide(PETSc.PC.Side.RIGHT)
            self.rough.setFromOptions()
        self.rough.setOperators(self.matrix)
        self.rough.setTolerances(rtol=tolerance, atol=1e-300, max_it=100)
        self.b.array[:] = rhs
        self.rough.solve(self.b, self.x)
        return self.x.array

    def _try(self, ksp, guess):
        self.x.array[:] = guess
        try:
            ksp.solve(self.b, self.x)
            failed = not finite(self.x.array)
        except PETSc.Error:  # a preconditioner that cannot be built or applied on this rank
            failed = True
        self.iterations = ksp.getIterationNumber()
        return not largest(self.ranks, float(failed)) and ksp.getConvergedReason() > 0

    def _fallback(self, method, preconditioner):
        ksp = PETSc.KSP().create(self.matrix.comm)
        ksp.setOptionsPrefix(self.name + "_fallback_")
        ksp.setOperators(self.matrix)
        ksp.setType(method)
        ksp.getPC().setType(preconditioner if is_there(preconditioner) else "gamg")  # PyPI's PETSc has no hypre
        if preconditioner == "lu":
            ksp.getPC().setFactorSolverType("mumps")
        if method == "fgmres":
            ksp.setGMRESRestart(80)
        ksp.setTolerances(rtol=self.ksp.getTolerances()[0], atol=1e-300, max_it=800)
        ksp.setConvergenceHistory(reset=True)
        self._read_options(ksp)
        return ksp
