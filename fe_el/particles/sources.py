"""Where an injector's particles come in: through boundary facets, a disc, or points."""
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from fe_el.checks import finite_vector, points, positive_number, require_tags
from fe_el.mesh import cell_mesh as _mesh

if TYPE_CHECKING:
    from fe_el.particles.particles import Particles

INSIDE = 1e-9  # how far inside the boundary places lie, over the extent of the source


def inward_facets(particles, facet_tags, group):
    """Corners (facets, d, 3), areas (facets,) without the thickness, and normals (facets, 3) into the mesh of tagged
    boundary facets, in an order that does not depend on the ranks.

    Note:
        Collective.
    """
    corner = _mesh.boundary_facets(particles.mesh, facet_tags, group)[0]
    corner = np.array([x[_mesh.by_place(x)] for x in corner])
    edges = corner[:, 1:] - corner[:, :1]
    normal = np.cross(edges[:, 0], edges[:, 1] if corner.shape[1] == 3 else np.array([0.0, 0.0, 1.0]))
    area = np.linalg.norm(normal, axis=1)
    normal /= area[:, None]
    inside = particles.search(corner.mean(1) + np.sqrt(area.mean()) * 1e-3 * normal) >= 0
    inside = np.any(particles.comm.allgather(inside), axis=0)
    normal[~inside] *= -1
    return corner, area, normal


class FacetSource:
    """All facets of a boundary group.

    Args:
        facet_tags, group: boundary facets.

    Raises:
        ValueError: for a group without facets, when an injector takes it.
    """

    def __init__(self, facet_tags: Any, group: int | str) -> None:
        self.facet_tags, self.group = facet_tags, group

    def prepare(self, particles: "Particles") -> None:
        """Take up the geometry. Collective."""
        require_tags("facet tags of an injector", self.facet_tags, particles.mesh)
        self.corner, area, self.normal = inward_facets(particles, self.facet_tags, self.group)
        d = self.corner.shape[1]
        self.area = area / 2 if d == 3 else area * particles.thickness
        self.depth = INSIDE * np.ptp(self.corner, (0, 1)).max()

    def quadrature(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Places (n, 3), normals (n, 3) and areas (n,) over which a velocity is integrated."""
        d = self.corner.shape[1]
        pull = 1 / 3 ** 0.5 if d == 2 else 0.5  # how far the points lie from the centre towards the vertices
        at = self.corner.mean(1)[:, None] * (1 - pull) + pull * self.corner
        return at.reshape(-1, 3), np.repeat(self.normal, d, 0), np.repeat(self.area / d, d)

    def places(self, generator: np.random.Generator, count: int, first: int) -> tuple[np.ndarray, np.ndarray]:
        """Random places (count, 3), uniform over the area, and the normals (count, 3) there."""
        d, share = self.corner.shape[1], np.cumsum(self.area)
        random = generator.random((count, d))
        f = np.minimum(np.searchsorted(share, random[:, 0] * share[-1], side="right"), len(share) - 1)
        weight = random[:, 1:]
        if d == 3:  # the other half of the parallelogram
            weight = np.where((weight.sum(1) > 1)[:, None], 1 - weight, weight)
        corner = self.corner[f]
        x = corner[:, 0] + np.einsum("nk,nkj->nj", weight, corner[:, 1:] - corner[:, :1])
        return x + self.depth * self.normal[f], self.normal[f]


class DiscSource:
    """A disc anywhere in the mesh, or on its boundary; in two dimensions a segment.

    Args:
        centre: [m].
        normal: direction in which particles come in.
        diameter (float): [m].

    Raises:
        ValueError: for a normal of zero or a diameter that is not positive.
    """

    RINGS, ANGLES = 16, 16  # of the quadrature

    def __init__(self, centre: ArrayLike, normal: ArrayLike, diameter: float) -> None:
        self.centre, self.diameter = finite_vector("centre of the disc", centre), positive_number("diameter", diameter)
        normal = finite_vector("normal of the disc", normal)
        if not normal.any():
            raise ValueError("The normal of the disc is zero; give the direction in which particles come in.")
        self.normal = normal / np.linalg.norm(normal)

    def prepare(self, particles: "Particles") -> None:
        """Take up the dimension and the thickness of the mesh."""
        self.flat = particles.mesh.topology.dim == 2
        n, radius = self.normal, 0.5 * self.diameter
        self.area = self.diameter * particles.thickness if self.flat else np.pi * radius ** 2
        first = np.array([-n[1], n[0], 0.0]) if self.flat else np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
        self.axes = radius * np.array([first / np.linalg.norm(first), np.cross(n, first / np.linalg.norm(first))])

    def quadrature(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Places (n, 3), normals (n, 3) and areas (n,) over which a velocity is integrated."""
        if self.flat:
            count = self.RINGS * self.ANGLES
            x = self._at((2 * np.arange(count) + 1) / count - 1, np.zeros(count))
        else:
            r, angle = np.meshgrid(np.sqrt((np.arange(self.RINGS) + 0.5) / self.RINGS),
                                   2 * np.pi * np.arange(self.ANGLES) / self.ANGLES)
            x = self._at((r * np.cos(angle)).ravel(), (r * np.sin(angle)).ravel())
        return x, np.tile(self.normal, (len(x), 1)), np.full(len(x), self.area / len(x))

    def places(self, generator: np.random.Generator, count: int, first: int) -> tuple[np.ndarray, np.ndarray]:
        """Random places (count, 3), uniform over the area, and the normals (count, 3) there."""
        random = generator.random((count, 2))
        if self.flat:
            x = self._at(2 * random[:, 0] - 1, np.zeros(count))
        else:
            r, angle = np.sqrt(random[:, 0]), 2 * np.pi * random[:, 1]
            x = self._at(r * np.cos(angle), r * np.sin(angle))
        return x, np.tile(self.normal, (count, 1))

    def _at(self, a, b):
        """Places at multiples of the two radii that span the disc."""
        return self.centre + a[:, None] * self.axes[0] + b[:, None] * self.axes[1] \
            + INSIDE * self.diameter * self.normal


class PointSource:
    """Points that take turns.

    Args:
        position: (points, 2 or 3) [m].
    """

    def __init__(self, position: ArrayLike) -> None:
        self.position = points("positions of an injector", position)

    def prepare(self, particles: "Particles") -> None:
        """Nothing to take up."""

    def places(self, generator: np.random.Generator, count: int, first: int) -> tuple[np.ndarray, None]:
        """The places (count, 3) of the parcels from number ``first`` on; there are no normals."""
        return self.position[(first + np.arange(count)) % len(self.position)], None
