"""Which cell and which rank each particle is on: locating, order in memory, and moves between ranks."""
import numpy as np

from fe_el.mesh import cell_mesh as _mesh
from fe_el.parallel.exchange import largest_of, move, raise_everywhere, sums_of, total_of
from fe_el.particles import location, motion
from fe_el.particles.arrays import ParticleArrays
from fe_el.particles.open_boundaries import OpenBoundaries, Rebounds

MOST_REBOUNDS = 8  # of a particle in one step


class LostParticle(RuntimeError):
    """A particle is in no cell of the mesh."""


class Migration(ParticleArrays):
    """What :class:`Particles` do to find their cells and to change rank."""

    halo_width: float  #: [m], of the cells known around the owned ones
    _curve: np.ndarray | None
    _place: tuple[np.ndarray, np.ndarray] | None
    _open: OpenBoundaries | None
    _rebounds: Rebounds | None

    def reach_halo(self, width: float) -> None:
        """Make the halo of cells at least ``width`` wide [m]."""
        if width > self.halo_width:
            alone, self.halo_width = self.comm.size == 1 and self.halo_width >= 0, width
            if alone:
                return  # one rank has all cells
            self.cells, self.halo = _mesh.cell_mesh(self.mesh, width, self.thickness, self.period)
            self.search, self._curve = location.CellSearch(self.cells), None
            number = len(self.cells.volume)
            self._cell_owner = (self.halo.forward(np.full(number, self.comm.rank, np.int32)),
                                self.halo.forward(np.arange(number, dtype=np.int32)))

    def put_in_order(self) -> None:
        """Sort many particles by their cells where those that follow each other in memory are no longer near in space."""
        if not total_of(self.comm, int(len(self) >= location.MANY)):
            return
        if self._curve is None:
            self._curve = location.curve_through(self.cells)
        order = location.order_by_cell(self.cell, self.position, self._curve)
        if total_of(self.comm, int(len(order) > 0)):  # on all ranks or on none, as contacts note it
            self.select(order if len(order) else np.arange(len(self)))

    def locate(self, in_order: bool = True) -> np.ndarray | None:
        """Find the cell of every particle and move particles to the ranks of their cells.

        Args:
            in_order (bool): those that stay keep their order, and those that come are behind them; else they may take the
                rows of those that go, which costs less.

        Returns:
            ndarray: rank every particle (in the old order) is on now, -1 if it left the mesh; ``None`` if all stayed.

        Raises:
            LostParticle: if a particle is in no cell of any rank.

        Note:
            Collective.
        """
        self.wrap(self.position)
        self._gone = np.zeros(0, np.int64)
        missing = location.locate(self.cells, self.cell, self.position)
        if total_of(self.comm, missing):
            self._search_everywhere()
        if self.comm.size == 1 and not len(self._gone):
            return None
        return self._migrate(in_order)

    def _search_everywhere(self):
        bad, self._claims = np.flatnonzero(self.cell < 0), {}
        for _ in range(MOST_REBOUNDS + 1):
            bad = self._still_lost(bad)
            turned = 0 if self._rebounds is None else self._rebounds.turn_back(self.position, self.velocity, bad)
            if not total_of(self.comm, turned):
                break
        gone = sums_of(self.comm, len(self._gone), self.mass[self._gone].sum())
        self.left, self.left_mass = self.left + int(gone[0]), self.left_mass + gone[1]
        message = None
        if len(bad):
            i = bad[0]
            message = (f"Particle {self.id[i]} is outside the mesh at {self.position[i].tolist()} with velocity "
                       f"{self.velocity[i].tolist()} (step {self.step}, rank {self.comm.rank}). Name the boundary it "
                       "crossed in walls=, use a smaller step, or a stiffer contact law.")
        raise_everywhere(self.comm, LostParticle, message)

    def _still_lost(self, lost):
        """Those of some rows that are in no cell of any rank and did not leave, either. Collective."""
        where = self.search(self.position[lost])
        if self.comm.size > 1:
            everywhere = self.comm.allgather(self.position[lost])
            found = self.comm.alltoall([self.search(x) for x in everywhere])
            self._claims |= {int(i): (r, f[k]) for k, i in enumerate(lost) for r, f in enumerate(found) if f[k] >= 0}
            where = np.array([0 if int(i) in self._claims else -1 for i in lost], np.int32)
        else:
            self.cell[lost] = where
        bad = lost[where < 0]
        if self._open is not None and len(bad):
            out = self._open.left_through(self.position[bad], self.velocity[bad])
            self._gone, bad = np.concatenate([self._gone, bad[out]]), bad[~out]
        return bad

    def _migrate(self, in_order):
        """Send particles in halo cells to the owners of these cells."""
        owned = self.cells.owned
        inside = np.maximum(self.cell, 0)
        destination, target = self._cell_owner[0][inside], self._cell_owner[1][inside].copy()
        for i, (rank, cell) in getattr(self, "_claims", {}).items():
            destination[i], target[i] = rank, cell
        self._claims = {}
        destination[self._gone] = -1
        leaving = destination != self.comm.rank
        self.cell = np.where(leaving | (self.cell < 0), target, self.cell).astype(np.int32)
        assert (self.cell[~leaving] < owned).all()
        if not self.comm.allreduce(int(leaving.sum())):
            return None
        own, user = self.arrays()
        out, stay = np.flatnonzero(leaving), np.flatnonzero(~leaving)
        received = move(self.comm, destination[out], [a[out] for a in (*own.values(), *user.values())])
        for name, a in zip(own, received):
            setattr(self, name, self._in_place_of(out, stay, name, own[name], a, in_order))
        self.properties = {name: self._in_place_of(out, stay, "property " + name, user[name], a, in_order)
                           for name, a in zip(user, received[len(own):])}
        self.layout += 1
        return destination

    def wrap(self, position: np.ndarray) -> None:
        """Bring positions into the periodic box, in place, so that the walk to a far cell is short."""
        if self.period is not None:
            for k in np.flatnonzero(self.period):
                position[:, k] -= np.floor(position[:, k] / self.period[k]) * self.period[k]

    def located(self, ahead: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Cell and position (wrapped into a periodic box) of every particle now, without changing the particles.

        A particle that is on its way out of the mesh keeps its last cell, until the next :meth:`locate` removes it or says
        that it is lost. The next call writes into the same arrays.

        Args:
            ahead (float): where velocity and acceleration of the last step take it in that half of a step [s]; now, if that
                is outside the mesh.

        Note:
            Collective.
        """
        if self._place is None or len(self._place[1]) != len(self):
            self._place = np.empty_like(self.cell), np.empty_like(self.position)
        if not ahead:
            return self._now(slice(None), *self._place)
        cell, place = self._place
        longest = motion.places_ahead(self.position, self.velocity, self.force, self.mean_contact_force, self.inertia,
                                      self.gravity, self.relaxation_rate, self.held, ahead, place)
        if len(self.late):
            place -= self.late[:, None] * (place - self.position)
        reach = largest_of(self.comm, longest, self.diameter.max(initial=0.0))
        if reach[0] + 3 * reach[1] > self.halo_width:
            self.reach_halo(1.5 * reach[0] + 3 * reach[1])
        if self._walk(self.cell, cell, place):  # some may be found from where they are now
            rows = np.flatnonzero(cell < 0)
            now, position = self._now(rows, cell[rows], place[rows])
            later, far = now.copy(), place[rows]
            self._walk(now, later, far)
            cell[rows] = np.where(later < 0, now, later)
            place[rows] = np.where((later < 0)[:, None], position, far)
        return cell, place

    def _now(self, rows, cell, place):
        """Fill in cells and wrapped positions of some particles; those outside the mesh keep their last cell."""
        last, place[:] = self.cell[rows], self.position[rows]
        if self._walk(last, cell, place):
            cell[cell < 0] = last[cell < 0]
        return cell, place

    def _walk(self, start, cell, place):
        """Fill in the cells, -1 outside the mesh, of points near the cells ``start``, and wrap the points; returns how many
        are outside.

        The walk takes points through periodic facets; only what it does not find is wrapped first, as the cells of another
        period may be on another rank.
        """
        cell[:] = start
        outside = location.locate(self.cells, cell, place)
        if outside and self.period is not None:
            far = np.flatnonzero(cell < 0)
            again, wrapped = start[far], place[far]
            self.wrap(wrapped)
            outside = location.locate(self.cells, again, wrapped)
            cell[far], place[far] = again, wrapped
        return outside
