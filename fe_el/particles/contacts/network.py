"""The contacts between particles as arrays: where they are, how deep, and what their springs give."""
import numpy as np


def network_of(contacts):
    """Arrays of the contacts between particles of this rank; see :meth:`Contacts.network`."""
    lists = contacts.lists
    if lists.pairs is None:  # no step was made yet
        at, first, second, x, radius, ids = (np.zeros(0, np.int64),) * 3 + (np.zeros((0, 3)),) + (np.zeros(0),) * 2
    else:
        first, second, x, radius, ids = lists.pairs.first, lists.pairs.second, lists.rows.x, lists.rows.radius, lists.ids
        mine = (second < lists.ghosts.owned) | (ids[first] < ids[second])
        at = np.flatnonzero((lists.pairs.stamp == contacts.step) & mine)
    i, j = first[at], second[at]
    ends = np.stack([x[i], x[j]], 1)
    arm = ends[:, 0] - ends[:, 1]
    distance = np.linalg.norm(arm, axis=1)
    overlap = radius[i] + radius[j] - distance
    out = {"position": ends, "id": np.stack([ids[i], ids[j]], 1).astype(np.int64), "overlap": overlap}
    if hasattr(contacts.law, "table"):
        out |= _forces(contacts.law, overlap, radius[i] * radius[j] / (radius[i] + radius[j]),
                       lists.pairs.spring[at] if len(at) else np.zeros((0, 4)),
                       *(lists.rows.material[k].astype(np.int64) if len(at) else k for k in (i, j)))
    return out


def _forces(law, overlap, reduced, spring, one, other):
    """Forces of the springs: Hertz' or the linear normal force less cohesion, and the tangential spring's."""
    several = law.table.shape[0] > 1
    row = law.table[one, other] if several else np.broadcast_to(law.table[0, 0], (len(overlap), 8))
    stiffness, exponent = row[:, 0], 1.0
    tangential = row[:, 3] * stiffness
    if law.kind == 1:
        stiffness = 2 * row[:, 0] * np.sqrt(reduced * np.maximum(overlap, 0.0))
        tangential, exponent = 4 * row[:, 3] * stiffness, 2 / 3
    pull = row[:, 6] * 2 * np.pi * reduced * (overlap if law.kind == 1 else 1.0)
    return {"normal_force": exponent * stiffness * overlap - pull, "tangential_force": -tangential[:, None] * spring[:, :3]}
