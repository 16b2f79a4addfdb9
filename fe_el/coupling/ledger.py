"""The balances that a coupling keeps of each step, and its clock."""
import time

import numpy as np

from fe_el.parallel.exchange import largest_of, sums_of


class Ledger:
    """Solid volume and momentum of :class:`Coupling`."""

    force_given: np.ndarray  #: (d,) [N] what all particles got by fields of the fluid in the last step
    force_missing: np.ndarray  #: (d,) [N] the part of it that the fluid did not lose

    def _momentum_ledger(self, given, received, mass, changed):
        """What particles and fluid gained against each other, and whether the fluid changed anywhere in the step."""
        p, d = self.particles, self.dimension
        sums = sums_of(self.comm, *given, *(given + received), mass, changed)
        self.answers = bool(sums[-1] > 0)
        self.force_given, self.force_missing = sums[:d].copy(), sums[d:2 * d].copy()
        weight = sums[-2] * np.linalg.norm(p.gravity)
        self.momentum_imbalance = float(np.abs(sums[d:2 * d]).max() / (weight or max(np.linalg.norm(sums[:d]), 1e-300)))

    def _begin(self):
        return time.perf_counter(), self.seconds.get("smoothing", 0.0)

    def _end(self, stage, tick):
        """Book the time of a stage, less the smoothing inside it."""
        self.seconds[stage] += time.perf_counter() - tick[0] - (self.seconds.get("smoothing", 0.0) - tick[1])

    def _solid_ledger(self, volume):
        """Solid volume on the cells against ``volume`` of this rank's particles, and the fullest cell."""
        cells, n = self.particles.cells, self.particles.cells.owned
        on_cells, of_particles = sums_of(self.comm, self.solid[:n, 0] @ cells.volume[:n], volume)
        self.solid_volume_error = abs(on_cells - of_particles) / max(of_particles, 1e-300)
        self.max_solid_fraction = float(largest_of(self.comm, self.solid[:n, 0].max(initial=0.0))[0])
