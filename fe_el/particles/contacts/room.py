"""How far particles and walls may move before the lists of contacts are out of date."""
import numpy as np

from fe_el.parallel.exchange import largest_of
from fe_el.particles.contacts.step_ends import unchanged
from fe_el.particles.contacts.wall_shapes import FACETS, SURFACE

AHEAD = 80  # sub-steps that particles and walls have room for at their present speed


WIDEST = 0.5  # room at most, over the largest diameter


class Room:
    """Skin and room of :class:`ContactLists`."""

    def _wall_speed(self):
        """Largest speed of a wall that moves, where the particles of this rank are [m/s]."""
        if not self.has_shapes:
            return 0.0
        moving = self.motion[self.kind != FACETS]
        size = np.ptp(self.particles.position, 0).max(initial=0.0) if len(self.particles) else 0.0
        size = np.array([w.radius if w.kind == SURFACE else size for w in self.walls if w.kind != FACETS])
        return float((np.linalg.norm(moving[:, 3:6], axis=1) + np.linalg.norm(moving[:, 6:], axis=1) * size).max())

    def has_moving_shapes(self):
        """Whether a wall leaves its place."""
        return bool(self.motion[self.kind != FACETS, 3:].any() or self.load[:, 4].any())

    def _choose_skin(self, smallest, largest, speed, h):
        """A skin that lasts some hundred sub-steps with the room that speed adds; always several of the fastest particle."""
        if self._skin is None:
            if self.skin is None:
                self.skin = 0.1 * smallest
            elif self.age < 160:
                self.skin *= 1.25
            elif self.age > 400:
                self.skin *= 0.9
            self.skin = min(max(self.skin, 0.04 * smallest), 0.2 * smallest)
            self._ahead, self._most = AHEAD * h, max(0.5 * self.skin, self._widest(largest), 3 * h * speed)
        elif 4 * h * speed > self.skin:
            raise ValueError(f"The fastest particle moves {h * speed:g} m in one sub-step of {h:g} s, too much for the skin "
                             f"of "
                             f"{self.skin:g} m; leave skin= out, or use more steps_per_contact.")
        if self._room(speed) > largest > 0:
            raise FloatingPointError(f"The fastest particle (velocity {speed:g} m/s) moves {h * speed:g} m in one sub-step "
                                     f"of "
                                     f"{h:g} s, more than a third of the largest diameter {largest:g} m: contacts would be "
                                     f"missed. Use a step below {0.2 * largest / speed:g} s: more steps_per_contact, or a "
                                     "stiffer law.")

    def _choose_wall_room(self, largest, h):
        """How far planes and cylinders may move before the lists are out of date [m], and their speed over that [1/s]."""
        falls = (self.load[:, 3] * self.load[:, 4]).max() * AHEAD * h  # speed that loads give until the lists are old
        speed = self.wall_top = largest_of(self.particles.comm, max(self._wall_speed() + falls, self.wall_top))[0]
        self.wall_room = max(0.5 * self.skin, min(AHEAD * h * speed, WIDEST * largest), 3 * h * speed) if speed else 0.0
        self.wall_rate = speed / self.wall_room if speed else 0.0

    def _widest(self, largest):
        """Room of the fastest particles [m], such that ghosts remain few and contacts in a periodic box unique."""
        period = self.particles.period
        short = np.inf if period is None or not (period > 0).any() else period[period > 0].min()
        return min(WIDEST * largest, 0.24 * short - 0.5 * largest)

    def _room(self, speed):
        """How far particles of a speed [m/s] may move before the lists are out of date [m]."""
        return np.minimum(0.5 * self.skin + self._ahead * speed, self._most)

    def _check_period(self, largest, widest):
        p, need = self.particles, 2 * (largest + 2 * widest)
        if p.period is not None and ((p.period > 0) & (p.period < need)).any():
            raise ValueError(f"The periodic box has lengths {p.period.tolist()}; contacts of particles of diameter "
                             f"{largest:g} m "
                             f"need at least {need:g} m in every periodic direction.")

    def _particles_changed(self):
        p, n = self.particles, len(self.particles)
        if self.ghosts is None or self.ghosts.owned != n:
            return False
        rows = self.rows
        return not len(p.material) == len(p.held) == n or not unchanged(
            p.diameter, p.position, p.held, p.mass, p.material, p.number,
            (rows.x, rows.radius, rows.inverse_mass, rows.material), self.number)
