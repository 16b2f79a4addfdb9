"""How evenly the ranks have particles and cells."""
import sys

import numpy as np

from fe_el.mesh.partition import PARTICLE_WORK
from fe_el.particles.migration import Migration

EVERY, UNEVEN = 1000, 1.25  # steps between looks; largest work of a rank over the mean from which on a new cut pays


class Balanced(Migration):
    """What :class:`Particles` know of their distribution over the ranks."""

    step: int
    _said = UNEVEN  # what was complained of last

    def imbalance(self) -> dict[str, float]:
        """Largest over mean of what the ranks have, 1 where all have as much: ``particles_imbalance``, ``cells_imbalance``,
        and ``work_imbalance`` of both together, a particle as much work as ten cells.

        Note:
            Collective.
        """
        have = np.array(self.comm.allgather((len(self), self.cells.owned)), float) @ [[1, 0, PARTICLE_WORK], [0, 1, 1]]
        even = have.max(0) / np.maximum(have.mean(0), 1e-300)
        return {name + "_imbalance": float(e) if e else 1.0 for name, e in zip(("particles", "cells", "work"), even)}

    def say_balance(self) -> None:
        """One line on several ranks: at the first step, and later where the work has become more uneven. Collective."""
        if self.comm.size == 1 or self.step != 1 and self.step % EVERY:
            return
        now = self.imbalance()
        uneven = now["work_imbalance"] > self._said
        if uneven:
            self._said = UNEVEN * now["work_imbalance"]
        if self.comm.rank == 0 and (uneven or self.step == 1):
            advice = ("; a mesh that is made with balance=, of these particles or of their checkpoint, parts them evenly"
                      if uneven else "")
            print(f"{self.comm.size} ranks, step {self.step}: largest over mean number of particles "
                  f"{now['particles_imbalance']:.2f}, of cells {now['cells_imbalance']:.2f}, of the work with both "
                  f"{now['work_imbalance']:.2f}{advice}.", file=sys.stderr, flush=True)
