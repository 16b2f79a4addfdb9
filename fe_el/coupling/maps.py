"""Maps between particles and cells: mapped, smoothed, spilled; and their transpose."""
import time

import numpy as np
from numpy.typing import ArrayLike

from fe_el.parallel.exchange import raise_everywhere

OTHER_PARTICLES = "Particles came, left or changed rank since they were mapped; call to_fluid(dt) first."


class Maps:
    """The maps of a coupling, which has ``particles``, ``mapping``, ``smoothing``, ``near``, ``linear``, ``spill``,
    ``fields`` and ``_work``."""

    def to_cells(self, quantity: ArrayLike) -> np.ndarray:
        """Cell densities of what particles give off, by the map that gives the fluid their volume and their forces.

        Args:
            quantity: (particles,) or (particles, k), for instance a heat flow [W].

        Returns:
            (owned cells,) or (owned cells, k) per volume; their integral is the sum over the particles.

        Raises:
            RuntimeError: before :meth:`to_fluid` of the step has found the particles' shares.

        Note:
            Collective.
        """
        self._check_mapped()
        quantity = np.asarray(quantity, float)
        return self._to_cells(quantity) if quantity.ndim == 2 else self._to_cells(quantity[:, None])[:, 0]

    def at_particles(self, field: ArrayLike) -> np.ndarray:
        """Means of a cell field at the particles: the transpose of :meth:`to_cells`, so what one gains the other loses.

        With cell volumes V and any field: sum(V field . to_cells(q)) = sum(at_particles(field) . q), to round-off.

        Args:
            field: (owned cells,) or (owned cells, k).

        Returns:
            (particles,) or (particles, k), in the units of the field.

        Raises:
            RuntimeError: before :meth:`to_fluid` of the step has found the particles' shares.

        Note:
            Collective.
        """
        self._check_mapped()
        field = np.ascontiguousarray(field, float)
        return self._at_particles(field) if field.ndim == 2 else self._at_particles(field[:, None])[:, 0]

    def _check_mapped(self):
        """The shares must be those of the particles that are here now."""
        raise_everywhere(self.comm, RuntimeError, None if self.layout == self.particles.layout else OTHER_PARTICLES)

    def _owned_volume(self):
        cells = self.particles.cells
        return cells.volume[:cells.owned, None]

    def _smooth_first(self, density):
        """Smoothed density of the particles, which are in the cells where it is not zero; the step's smoothing is then done
        near those only."""
        if hasattr(self.smoothing, "near") and self.linear is None:  # which sees cells that hold no particle, too
            tick = time.perf_counter()
            self.near = self.smoothing.near(density[:, 0] > 0, self.near)
            self.seconds["smoothing"] += time.perf_counter() - tick
        return self._smooth(density)

    def _smooth(self, field, back=False):
        """Smoothing of owned cell values from particles, or ``back`` to them; the identity without."""
        if self.smoothing is None:
            return field
        tick = time.perf_counter()
        smooth = self.smoothing if self.near is None else self.near.back if back else self.near.spread
        out = smooth(np.ascontiguousarray(field))
        self.seconds["smoothing"] += time.perf_counter() - tick
        return out

    def _deposit(self, quantity):
        """Cell totals (cells, k) of particle quantities, complete on owned and halo cells."""
        p = self.particles
        out = np.zeros((len(p.cells.volume), quantity.shape[1]))
        self.mapping.deposit(np.ascontiguousarray(quantity), out)
        return p.halo.forward(p.halo.reverse_add(out))

    def _volumes(self, density):
        """Cell totals on owned and halo cells from densities on owned ones."""
        return self._on_cells(density) * self.particles.cells.volume[:, None]

    def _to_cells(self, quantity):
        """Cell densities (owned cells, k) of particle quantities (particles, k): mapped, smoothed, spilled."""
        n = self.particles.cells.owned
        if self.smoothing is None:
            return self.spill(self._deposit(quantity))[:n] / self._owned_volume()
        return self.spill(self._volumes(self._smooth(self._deposit(quantity)[:n] / self._owned_volume())))[:n] \
            / self._owned_volume()

    def _back(self, field):
        """Owned cell values made ready for particles: spilled back, then smoothed; the transpose of :meth:`to_cells`."""
        out = self.spill.transpose(self._on_cells(field))
        return out if self.smoothing is None else self._on_cells(self._smooth(out[:len(field)], back=True))

    def _at_particles(self, field):
        """The same (particles, k) of (owned cells, k)."""
        out = np.empty((len(self.particles), field.shape[1]))
        self.mapping.gather(self._back(field), out)
        return out

    def _on_cells(self, owned):
        """Owned cell values continued to the halo."""
        p = self.particles
        out = np.zeros((len(p.cells.volume), owned.shape[1]))
        out[:len(owned)] = owned
        return p.halo.forward(out)

    def _gather(self, field, name="field"):
        """Particle means of a field on owned and halo cells, in the array that is kept for the name."""
        out = self._work.empty(name, len(self.particles), field.shape[1])
        self.mapping.gather(field, out)
        return out

    def _set(self, which, values):
        n = self.particles.cells.owned
        self.values[which][:n * values.shape[1]] = values[:n].ravel()
        if self.comm.size > 1:
            self.fields[which].x.scatter_forward()
