"""The state of contacts, for checkpoints: springs by what does not change, and where walls are."""
from typing import TYPE_CHECKING

import numpy as np

from fe_el.mesh.places import nearest
from fe_el.parallel.exchange import largest_of
from fe_el.particles.contacts.springs import Kept

if TYPE_CHECKING:
    from fe_el.particles.contacts.contact_lists import ContactLists
    from fe_el.particles.particles import Particles


class SavedLists:
    """What :class:`ContactLists` take back."""

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
            if name == "facets" and len(other):
                other, found = nearest(self.facets.corner.mean(1), other, None)
                here &= found
            spring = rows["spring"][here].reshape(-1, self.width)
            kept.append(Kept(order[place[here]], other[here].astype(np.int64), spring))
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
        p, same = self.particles, state["same"]
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
