"""What stops contacts: parts that do not go together, and runs that go wrong."""
import numpy as np

from fe_el.checks import of_kind, require_tags
from fe_el.parallel.exchange import raise_everywhere
from fe_el.particles.contacts.array_law import ArrayLaw
from fe_el.particles.contacts.contact_laws import HertzMindlin, LinearSpringDashpot
from fe_el.particles.contacts.step_ends import first_not_finite
from fe_el.particles.contacts.wall_shapes import FACETS, SURFACE
from fe_el.particles.migration import LostParticle


class ContactChecks:
    """Checks of :class:`Contacts`."""

    def _check_parts(self):
        """Whether laws and walls go together."""
        for law in (self.law, self.wall_law):
            of_kind("contact law", law, LinearSpringDashpot, HertzMindlin, ArrayLaw)
        for wall in self.walls:
            if isinstance(wall, type) or not hasattr(wall, "motion"):
                raise ValueError(f"{wall!r} is no wall; use FacetWalls, PlaneWall, CylinderWall, SurfaceWall or "
                                 "(facet_tags, groups).")
            if sum(wall is other for other in self.walls) > 1:
                raise ValueError(f"The walls hold {wall!r} more than once; give each wall once.")
            if wall.kind == SURFACE and self.particles.mesh.topology.dim == 2:
                raise ValueError("A SurfaceWall is of triangles, the mesh of two dimensions; use planes or facets.")
            if wall.kind == FACETS:
                require_tags("facet tags of a wall", wall.facet_tags, self.particles.mesh)
        if self.walls and isinstance(self.wall_law, ArrayLaw):
            raise ValueError("An ArrayLaw acts between particles only; give walls a wall_law, for instance HertzMindlin.")
        self._check_materials()

    def _check_materials(self):
        for what, indices, law in (("particle", self.particles.material, self.law), *(
                ("wall", np.array([w.material]), self.wall_law) for w in self.walls)):
            count = getattr(law, "materials", None)
            if count and len(indices) and indices.max() >= count:
                raise ValueError(f"A {what} has material {indices.max()}, but the law has {count} material(s), numbered "
                                 f"from 0; "
                                 "give the law a larger table.")

    def _check_finite(self):
        """Stop before a position or force that is not a number spreads."""
        p, rows, message = self.particles, self.lists.rows, None
        i = first_not_finite(rows.x[:len(p)], rows.force)
        if i >= 0:
            message = (f"The contact force on particle {p.id[i]} near {p.position[i].tolist()} is "
                       f"{rows.force[i, :3].tolist()} (step {p.step}, rank {p.comm.rank}). Either two particles lie on one "
                       "point, or the step is too large for the law: insert without overlap, or use more steps_per_contact.")
        try:
            raise_everywhere(p.comm, FloatingPointError, message)
        except FloatingPointError:
            self.lists.forget_springs()
            raise

    def _check_behind(self):
        """Stop if a particle's centre came onto or behind a wall in the last sub-steps."""
        p, message = self.particles, None
        if self.behind is not None:
            i = self.behind
            message = (f"The centre of particle {p.id[i]} went onto or behind a wall near {p.position[i].tolist()} "
                       f"(step {p.step}, rank {p.comm.rank}): the overlap reached its radius. Use a stiffer contact "
                       "law, or a smaller step.")
        raise_everywhere(p.comm, LostParticle, message)
