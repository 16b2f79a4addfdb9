"""Walls from surfaces of triangles, which need not be facets of the mesh and may move."""
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fe_el.checks import numbers, positive_number
from fe_el.compiled.cache import njit
from fe_el.particles.contacts.wall_shapes import SURFACE, Wall

MERGED = 1e-9  # vertices closer than this share of the surface's size are one
FLAT = 1e-12  # triangles of less area than this share of the size squared are left out


class SurfaceWall(Wall):
    """A surface of triangles, for instance from an STL file, that moves as a rigid body; particles feel both of its sides.

    The triangles need not be facets of the mesh, and may lie partly outside of it; the fluid does not feel them. They move
    with ``velocity``, and turn with ``angular_velocity`` about ``point``, which moves along. Vertices in one place become
    one, triangles without area and copies are left out.

    Args:
        surface: file that meshio reads (STL, PLY, OBJ, ...), or (points (n, 3) [m], triangles (m, 3)).
        material (int): index into the law's material table.
        velocity, angular_velocity, point: of the motion now [m/s], [1/s], [m].
        scale (float): factor of all coordinates of a file or of the points: 0.001 for millimetres.
        may_be_open (bool): take a surface with open edges, such as a plate; else particles could slip through a hole.

    Attributes:
        open_edges (int): edges of one triangle only.
        turned: (3, 3) rotation since the surface was made.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for a file without triangles, triangles that do not fit the points, or open edges.
    """

    kind = SURFACE

    def __init__(self, surface: str | Path | Sequence[ArrayLike], material: int = 0, velocity: ArrayLike = (0, 0, 0),
                 angular_velocity: ArrayLike = (0, 0, 0), point: ArrayLike = (0, 0, 0), scale: float = 1.0,
                 may_be_open: bool = False) -> None:
        super().__init__(point, material, velocity, angular_velocity)
        points, triangles = _read(surface)
        corner, self.vertex = _cleaned(points * positive_number("scale of the surface", scale), triangles)
        self.body, self.turned = corner - self.point, np.eye(3)
        self.radius = float(np.sqrt((self.body ** 2).sum(2)).max())  #: largest distance from ``point`` [m]
        open_at = _open_edges(self.vertex)
        self.open_edges = len(open_at)
        if self.open_edges and not may_be_open:
            triangle, side = open_at[0]
            at = corner[triangle, [side, (side + 1) % 3]].mean(0)
            raise ValueError(f"The surface has {self.open_edges} open edges, one near {at.tolist()}: particles could slip "
                             "through. Close it, or pass may_be_open=True if it is a plate.")

    @property
    def shape(self) -> np.ndarray:
        """Rotation vector of the step so far, and a zero: none at its start."""
        return np.zeros(4)

    def restore(self, motion: np.ndarray, turned: np.ndarray) -> None:
        """Take back origin, velocity and rotation (9,), and how the wall is turned (3, 3)."""
        super().restore(motion, turned)
        self.turned = turned

    def moved(self, point: np.ndarray, shape: np.ndarray) -> None:
        """Take up where the wall is now."""
        self.point, self.turned = point.copy(), rotation(shape[:3]) @ self.turned

    def corners(self) -> np.ndarray:
        """Corners (triangles, 3, 3) where the wall is now [m]."""
        return self.point + self.body @ self.turned.T


def rotation(vector):
    """Matrix (3, 3) of the rotation about a vector by its length [rad] (Rodrigues)."""
    angle = np.linalg.norm(vector)
    if not angle:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def _read(surface):
    """Points (n, 3) and triangles (m, 3) of a file or of a pair."""
    if isinstance(surface, (str, Path)):
        if not Path(surface).is_file():
            raise FileNotFoundError(f"There is no surface {surface}; give the path of an STL file.")
        import meshio  # where a file is read, nowhere else
        try:
            mesh = meshio.read(surface)
        except Exception as error:  # readers of all formats raise their own
            raise ValueError(f"The surface {surface} cannot be read: {error}; give a file of triangles (STL).") from None
        points, triangles = mesh.points, [c.data for c in mesh.cells if c.type == "triangle"]
        triangles = np.concatenate(triangles) if triangles else np.zeros((0, 3), np.int64)
    elif isinstance(surface, (tuple, list)) and len(surface) == 2:
        points, triangles = (numbers(name, a) for name, a in zip(("points of a surface", "triangles of a surface"), surface))
    else:
        raise ValueError(f"The surface is {str(surface)[:60]!r}; give a file, or points (n, 3) and triangles (m, 3).")
    points, triangles = np.asarray(points, float), np.asarray(triangles)
    fits = points.ndim == 2 and points.shape[1] == 3 and np.isfinite(points).all() and triangles.ndim == 2 \
        and triangles.shape[1] == 3 and len(triangles) and (triangles == triangles.astype(np.int64)).all()
    if not fits or triangles.min() < 0 or triangles.max() >= len(points):
        raise ValueError(f"The surface has points of shape {points.shape} and triangles of shape {triangles.shape}; give "
                         "finite points (n, 3), and at least one triangle (m, 3) of their numbers.")
    return points, triangles.astype(np.int64)


def _cleaned(points, triangles):
    """Corners (triangles, 3, 3) and vertices (triangles, 3), those in one place merged; no flat triangles, no copies."""
    size = np.ptp(points, 0).max()
    _, number = np.unique(np.round((points - points.min(0)) / max(size, 1e-300) / MERGED), axis=0, return_inverse=True)
    vertex, corner = number.reshape(-1)[triangles], points[triangles]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    good = np.flatnonzero(area > FLAT * size ** 2)
    _, first = np.unique(np.sort(vertex[good], 1), axis=0, return_index=True)
    keep = good[np.sort(first)]
    if not len(keep):
        raise ValueError("The surface has no triangle with an area; give at least one.")
    return corner[keep], vertex[keep]


def _open_edges(vertex):
    """(triangle, side) of the edges that one triangle only has; side k goes from vertex k to the next."""
    edges = np.sort(np.stack([vertex, np.roll(vertex, -1, 1)], 2), 2).reshape(-1, 2)
    _, back, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    alone = np.flatnonzero(count[back.reshape(-1)] == 1)
    return np.column_stack([alone // 3, alone % 3])


@njit
def carry_facets(facets, carried, motion, turn, h):
    """Move the facets ``carried`` along with their walls, whose origins have moved already, by a sub-step of h."""
    corner, frame = facets.corner, facets.frame
    old = np.empty(3)
    for k in range(len(carried)):
        f = carried[k]
        w = facets.wall[f]
        for c in range(3):
            for q in range(3):
                old[q] = corner[f, c, q] - motion[w, q] + h * motion[w, 3 + q]
            for q in range(3):
                corner[f, c, q] = motion[w, q] + turn[w, q, 0] * old[0] + turn[w, q, 1] * old[1] + turn[w, q, 2] * old[2]
        for q in range(3):
            frame[f, q] = corner[f, 0, q]
        for c in range(3, 12, 3):
            old[:] = frame[f, c:c + 3]
            for q in range(3):
                frame[f, c + q] = turn[w, q, 0] * old[0] + turn[w, q, 1] * old[1] + turn[w, q, 2] * old[2]
