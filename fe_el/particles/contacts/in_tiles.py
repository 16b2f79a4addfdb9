"""The order of particles in memory, and the tiles that waves of sub-steps go through."""
from typing import TYPE_CHECKING, Any

import numpy as np

from fe_el.parallel.exchange import largest_of
from fe_el.particles.contacts import neighbours, waves
from fe_el.particles.contacts.records import Tiles
from fe_el.particles.ghosts import Ghosts, boxes_around

if TYPE_CHECKING:
    from fe_el.particles.particles import Particles

SORT_EVERY = 8  # rebuilds


class InTiles:
    """What :class:`ContactLists` do to keep particles that are near each other together in memory."""

    particles: "Particles"
    ghosts: Ghosts | None
    rebuilds: int
    strips: int  #: in a slab
    tile_layout: int | None  #: of the particles, when they were sorted by tiles
    tile_starts: Any  #: (tiles + 1,) first particle of each tile; None: not sorted
    x0: np.ndarray

    def _in_disorder(self, layout, in_tiles):
        """Whether particles are to be sorted, on all ranks. Collective."""
        if self.rebuilds % SORT_EVERY == 0 or layout is None:
            return True
        return in_tiles and largest_of(self.particles.comm, float(self.tile_layout != self.particles.layout))[0] > 0

    def _tile_of(self, size, in_tiles):
        """Number of each particle's tile, and the number of strips in a slab. Collective."""
        p = self.particles
        if in_tiles and p.comm.size == 1:
            return waves.tiles(p.position, p.period, size)
        boxes = boxes_around(p.comm, p.position, size, p.period) if in_tiles else None
        return (waves.layers(p.position, boxes, size) if in_tiles and len(p) else np.zeros(len(p), np.int64)), 1

    def _sort(self, kept, size, in_tiles):
        """Order the particles by boxes of two reaches along a Morton curve, for cache locality, and by tiles before that.
        Collective."""
        p = self.particles
        tile, self.strips = self._tile_of(size, in_tiles)
        if not len(p):
            self.tile_layout, self.tile_starts = p.layout if in_tiles else None, np.zeros(2, np.int64)
            return kept
        order = np.lexsort((p.id, neighbours.morton_code(p.position, neighbours.bounds(p.position)[0], 2 * size), tile))
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        p.select(order)
        self.tile_layout = p.layout if in_tiles else None
        count = -(-(int(tile.max()) + 1) // self.strips) * self.strips  # whole slabs
        self.tile_starts = np.concatenate([[0], np.cumsum(np.bincount(tile, minlength=count))])
        return [one._replace(particle=place[one.particle]) for one in kept]

    def _tiles(self, x, pairs):
        """Pairs in the order of their tiles, and these tiles without what is near walls. Collective."""
        p, n, ghosts, starts = self.particles, len(self.particles), self.ghosts, self.tile_starts
        tile, x0, images = np.repeat(np.arange(len(starts) - 1), np.diff(starts)), np.zeros((0, 4)), slice(n, None)
        tile = ghosts.grow(tile)
        if p.comm.size > 1:
            abroad, images = np.ones(len(tile), bool), ghosts.receive[p.comm.rank]
            abroad[:n] = abroad[images] = False
            starts, tile = waves.first_tile(starts, tile, np.append(ghosts.abroad, pairs[0][abroad[pairs[1]]]))
            tile[abroad], x0 = 0, ghosts.grow(self.x0)[n:]
            x0[:, :3] = x[n:]
        count, tile_of_image, none = len(starts) - 1, tile[images], np.zeros(0, np.int64)
        *pairs, pair_starts, apart, apart_strips = waves.by_tile(*pairs, tile, self.strips, count)
        order = np.argsort(tile_of_image, kind="stable")
        image_starts = np.searchsorted(tile_of_image[order], np.arange(count + 1))
        number, width = waves.at_once(n, count // self.strips, apart, self.strips, apart_strips)
        number = -int(largest_of(p.comm, -number)[0])  # the least of all ranks
        return *pairs, Tiles(starts, pair_starts, none, none, image_starts, order, x0, self.strips, apart, apart_strips,
                             number, width, images.start - n)
