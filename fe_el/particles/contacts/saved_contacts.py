"""The state of contacts, for checkpoints: springs by what does not change, and where walls are."""
from typing import TYPE_CHECKING

import numpy as np

from fe_el.mesh.places import nearest
from fe_el.parallel.exchange import largest_of
from fe_el.particles.contacts import springs
from fe_el.particles.contacts.blocks import aligned

if TYPE_CHECKING:
    from fe_el.particles.contacts.contact_lists import ContactLists
    from fe_el.particles.particles import Particles


class SavedLists:
    """What :class:`ContactLists` keep of their springs and take back."""

    def collect(self, step, layout, mirror=True):
        """Springs of the live contacts of the present lists: of pairs, facets and shapes.

        Those of pairs for both particles, or without ``mirror`` for one, which will do where both stay on this rank and are
        never seen as images of each other.
        """
        if self.pairs is None:
            # of a checkpoint, of other walls
            kept, old = self.restored or ([springs.none(self.width)] * 3, self.particles.id)
            return [springs.renumbered(one, old, self.particles.id) for one in kept]
        n = self.ghosts.owned
        out = [springs.Kept(*springs.collect_springs(*where, entries.spring, entries.stamp, step,
                                                     mirror and entries is self.pairs, n, self.ids))
               for where, entries in zip(self._partners(), (self.pairs, self.near_facets, self.shapes))]
        ids = self.particles.id
        return out if layout == self.particles.layout else [springs.renumbered(kept, self.ids[:n], ids) for kept in out]

    def _partners(self):
        """First particle, the other's place, and lasting numbers of all others, of each list."""
        facets, walls = np.arange(len(self.facets.wall)), np.arange(len(self.walls))
        return ((self.pairs.first, self.pairs.second, self.ids),
                (self.near_facets.particle, self.near_facets.facet, facets), (self.shapes.particle, self.shapes.wall, walls))

    def _memory_of_pairs(self, number):
        """(number, width) for the springs of a new list of pairs, which may hold old ones: those of the last list have been
        collected by then, and memory need not be cleared."""
        if self._springs is None or len(self._springs) < number:
            self._springs = aligned(number + number // 8, self.width)
            self._springs[:] = 0.0
        return self._springs[:number]

    def forget_springs(self):
        """Whatever a step that failed left in them: what is not a number stays so when it is multiplied by zero."""
        self._springs = None

    def restore(self, state):
        """Springs for the particles of this rank, and walls where they were."""
        p, kept, same = self.particles, [], state["same"]
        self.shape[:], self.motion[:], self.load[:, 5] = same["shape"], same["motion"], same["pushed"] / p.comm.size
        self.move_walls()
        for wall, motion, turned in zip(self.walls, self.motion, same["turned"]):
            wall.restore(motion, turned)
        self.pose_surfaces()
        order = np.argsort(p.id)
        for name in ("pairs", "facets", "shapes"):
            rows = state[name]
            place = np.searchsorted(p.id[order], rows["id"])
            here = place < len(order)
            here[here] = p.id[order][place[here]] == rows["id"][here]
            other = rows["other"]
            if name == "facets":
                other, found = nearest(self.facets.corner.mean(1), other, None) if len(other) else (other.ravel(), here)
                here &= found
            spring = rows["spring"][here].reshape(-1, self.width)
            kept.append(springs.Kept(order[place[here]], other[here].astype(np.int64), spring))
        self.forget_springs()
        self.skin = None if np.isnan(same["skin"]) else float(same["skin"])
        self.restored, self.pairs = (kept, p.id.copy()), None
        self.age, self.rebuilds = int(same["age"]), int(same["rebuilds"])

    def anew(self):
        """Forget what a run that goes on from a checkpoint does not know. Collective."""
        self.load[:, 5] = self.particles.comm.allreduce(self.load[:, 5]) / self.particles.comm.size
        self.tile_layout, self.wall_top = None, 0.0


class SavedContacts:
    """What :class:`Contacts` keep of themselves and take back."""

    particles: "Particles"
    lists: "ContactLists"
    layout: int | None  #: of the particles, when the lists were made
    step: int
    time: float
    largest_overlap: float

    def saved(self) -> dict[str, tuple]:
        """Springs of the live contacts, by the particles' numbers and the places of the facets; moving walls."""
        lists, p = self.lists, self.particles
        out: dict[str, tuple] = {}
        kept = lists.collect(self.step, self.layout)
        for (particle, partner, spring), name in zip(kept, ("pairs", "facets", "shapes")):
            other = partner
            if name == "facets":
                other = lists.facets.corner.mean(1)[partner]
            out[name] = (None, {"id": p.id[particle], "other": other, "spring": spring})
        skin = np.nan if lists.skin is None else lists.skin
        turned = np.array([wall.turned for wall in lists.walls])
        out["same"] = (None, {"step": self.step, "time": self.time, "turned": turned, "shape": lists.shape,
                              "pushed": p.comm.allreduce(lists.load[:, 5]), "motion": lists.motion, "skin": skin,
                              "age": lists.age, "rebuilds": lists.rebuilds, "known": self.layout == p.layout,
                              "largest_overlap": largest_of(p.comm, self.largest_overlap)[0]})
        return out

    def restore(self, state: dict[str, dict]) -> None:
        """Springs for the particles of this rank, given to the lists when these are made next; load the particles first."""
        p, same, walls = self.particles, state["same"], self.lists.walls
        if same["shape"].shape != self.lists.shape.shape:
            raise ValueError(f"The contacts have {len(walls)} walls, those of the checkpoint had {len(same['turned'])}; "
                             "give Contacts the walls that they had when it was saved, and change contacts.walls then.")
        for name in ("pairs", "facets", "shapes"):
            if len(state[name]["spring"]) and state[name]["spring"].shape[1] != self.lists.width:
                rolled = "rolling friction" if self.lists.width == 4 else "no rolling friction"
                raise ValueError(f"The contacts of the checkpoint had {rolled}, these have not the same; give Contacts a "
                                 "law of the kind that they had when it was saved.")
        self.lists.restore(state)
        self.step, self.time = int(same["step"]), float(same["time"])
        self.largest_overlap = float(same["largest_overlap"])
        self.layout = p.layout if same["known"] else None
        self.anew()

    def anew(self) -> None:
        """Let the next step make the lists anew, as a run that goes on from a checkpoint does."""
        self.stale = True
        self.lists.anew()
        if self.layout != self.particles.layout:
            self.layout = None
