"""What compiled loops of contacts are given, by name.

A record is made anew whenever one of its arrays is. There are n particles of this rank, and m rows of these and of ghosts,
which follow them. Loops take the arrays that they need out of a record before they begin.
"""
from typing import NamedTuple

import numpy as np

from fe_el.particles.contacts.blocks import Block
from fe_el.particles.contacts.contact_laws import LawNumbers


class Rows(NamedTuple):
    """Particles and their ghosts."""

    x: np.ndarray  #: (m, 3) position [m]
    state: np.ndarray  #: (m, 8) radius, velocity, angular velocity, inverse mass over radius
    force: np.ndarray  #: (m, 8) force in 0 to 2 [N], torque in 4 to 6 [N m]; 3 and 7 collect what is of no use
    radius: np.ndarray  #: (m,) [m]
    inverse_mass: np.ndarray  #: (m,) zero if held [1/kg]
    material: np.ndarray  #: (m,)
    parcel: np.ndarray  #: (m, 2) inverse mass [1/kg] and radius [m] of the particles in each; no rows: no parcels


class Drift(NamedTuple):
    """What moves the particles of this rank besides contacts."""

    external: np.ndarray  #: (n, 3) force [N]
    inverse_inertia: np.ndarray  #: (n,) inverse of the moment of inertia [1/(kg m^2)]
    x0: np.ndarray  #: (n, 4) positions when the lists were made [m], and one over the square of the room [1/m^2]
    fading: np.ndarray  #: (n or 0, 4) part of the force that fades [N], and its factor from one sub-step to the next


class Pairs(NamedTuple):
    """Pairs of particles that are listed."""

    first: np.ndarray  #: (pairs,) always of this rank
    second: np.ndarray  #: (pairs,)
    spring: np.ndarray  #: (pairs, 4 or 7) tangential spring, last normal velocity, and rolling spring
    stamp: np.ndarray  #: (pairs,) last sub-step in which they touched


class Candidates(NamedTuple):
    """Gaps when the lists were made, over the room of both, and room for the entries that may touch by now."""

    gap: np.ndarray  #: (pairs,)
    wall_gap: np.ndarray  #: (facet entries,)
    listed: np.ndarray  #: (pairs + 1,)
    wall_listed: np.ndarray  #: (facet entries + 1,)


class Near(NamedTuple):
    """How many of the candidates are listed, and up to which displacement that holds."""

    reach: float  #: share of the particles' room; infinite: all
    pairs: int
    facets: int


class Facets(NamedTuple):
    """Wall facets of this rank."""

    corner: np.ndarray  #: (facets, d, 3) [m]
    vertex: np.ndarray  #: (facets, d) numbers that facets share where they meet
    wall: np.ndarray  #: (facets,) number of the wall
    frame: np.ndarray  #: (facets, 12) first corner, dual edge vectors, unit normal
    patch: np.ndarray  #: (facets, 3) smooth patch, whether it is curved, and flat piece


class FacetScratch(NamedTuple):
    """Memory for the facets near one particle."""

    arm: np.ndarray  #: (most, 3) vector from the nearest point to the centre
    weight: np.ndarray  #: (most, 3) barycentric weights of that point
    slot: np.ndarray  #: (most,) entry of the list
    contact: np.ndarray  #: (most,) whether it is a contact
    work: np.ndarray  #: (most, 13) see :mod:`fe_el.particles.contacts.wall_patches`
    order: np.ndarray  #: (most,) those that are joined


class FacetRows(NamedTuple):
    """Facets near particles."""

    particle: np.ndarray  #: (entries,) in ascending order
    facet: np.ndarray  #: (entries,)
    spring: np.ndarray
    stamp: np.ndarray
    facets: Facets
    scratch: FacetScratch


class ShapeRows(NamedTuple):
    """Planes and cylinders near particles."""

    particle: np.ndarray  #: (entries,) in ascending order
    wall: np.ndarray  #: (entries,)
    spring: np.ndarray
    stamp: np.ndarray
    kind: np.ndarray  #: (walls,) see :mod:`fe_el.particles.contacts.wall_shapes`
    shape: np.ndarray  #: (walls, 4)


class WallRows(NamedTuple):
    """All walls, in the order of the list."""

    motion: np.ndarray  #: (walls, 9) origin, velocity, angular velocity
    material: np.ndarray  #: (walls,)
    force: np.ndarray  #: (walls, 6) sums over sub-steps of force [N] and torque about the origin [N m]
    deepest: np.ndarray  #: (1,) largest overlap over the diameter so far
    load: np.ndarray  #: (walls, 8) direction, size, inverse mass (0: none), force of a sub-step, way [m], sum of forces
    carried: np.ndarray  #: (facets that move,)
    turn: np.ndarray  #: (walls, 3, 3) rotation of each wall in a sub-step


class Tiles(NamedTuple):
    """Where the entries of each tile begin in the lists, for :mod:`fe_el.particles.contacts.waves`; one tile: none."""

    starts: np.ndarray  #: (tiles + 1,) particles
    pairs: np.ndarray  #: (tiles + 1,)
    facets: np.ndarray  #: (tiles + 1,)
    shapes: np.ndarray  #: (tiles + 1,)
    image_starts: np.ndarray  #: (tiles + 1,) in ``images``
    images: np.ndarray  #: periodic images of this rank's particles, tile by tile
    ghost_x0: np.ndarray  #: (ghosts, 4) as ``x0`` of :class:`Drift`; no rows on one rank
    strips: int  #: in a slab
    apart: int  #: how many slabs the particles of a pair may be apart
    apart_strips: int  #: the same of strips
    at_once: int  #: sub-steps that follow each other
    width: int  #: strips of a block
    first_image: int  #: ghosts before the periodic images of this rank's particles


class Assembly(NamedTuple):
    """All that sub-steps act on and with."""

    rows: Rows
    drift: Drift
    pairs: Pairs
    candidates: Candidates
    facets: FacetRows
    shapes: ShapeRows
    walls: WallRows
    pair_block: Block
    wall_block: Block
    pair_law: LawNumbers
    wall_law: LawNumbers
