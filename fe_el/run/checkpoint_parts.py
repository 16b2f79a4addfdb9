"""What of each part of a run a checkpoint holds, and how the part takes it back."""
import json

import numpy as np

from fe_el.particles.contacts.springs import Kept

# A state is a dict: name -> (points, arrays). With points (rows, 3) the arrays have a row for each and find their places by
# these;
# without (``None``) they are rows that the part sorts out itself. The name "same" holds numbers that are alike on every
# rank.


def particles_state(p):
    """All arrays of the particles, and the counters."""
    own, user = p.arrays()
    rows = {**own, **{"property:" + k: a for k, a in user.items()}, "centre": p.cells.corner[p.cell].mean(1)}
    return {"particles": (None, rows), "same": (None, {"next_id": p.next_id, "step": p.step, "left": p.left,
                                                       "left_mass": p.left_mass, "halo_width": p.halo_width})}


def set_particles(p, state):
    """Each rank takes the particles whose cells it owns."""
    rows, same = state["particles"], state["same"]
    p.reach_halo(max(3.0 * rows["diameter"].max(initial=0.0), float(same["halo_width"])))
    n = p.cells.owned
    cell, found = nearest(p.cells.corner[:n].mean(1), rows["centre"], p.period)
    total = p.comm.allreduce(int(found.sum()))
    if total != len(found):
        raise ValueError(f"The checkpoint holds {len(found)} particles, of which {total} are in cells of this mesh; load it "
                         "into the mesh that it was made with.")
    mine = np.flatnonzero(found)  # in the order in which they were: sums over them are then the same
    own, _ = p.arrays()
    if "number" not in rows:  # a file of an older version
        rows["number"] = rows["coarse_graining"] ** 3
    for name, a in own.items():
        values = rows[name][mine] if name in rows else np.zeros((len(mine), *a.shape[1:]))  # a file of an older version
        setattr(p, name, np.ascontiguousarray(values.astype(a.dtype)))
    p.cell = cell[mine].astype(np.int32)
    p.properties = {name[9:]: a[mine] for name, a in rows.items() if name.startswith("property:")}
    p.next_id, p.step, p.left = (int(same[k]) for k in ("next_id", "step", "left"))
    p.left_mass, p.layout = float(same["left_mass"]), p.layout + 1


def contacts_state(c):
    """Springs of the live contacts, by the particles' numbers and the places of the facets; moving walls."""
    lists, p, out = c.lists, c.particles, {}
    kept = lists.collect(c.step, c.layout)
    for (particle, partner, spring), name in zip(kept, ("pairs", "facets", "shapes")):
        other = partner
        if name == "facets":
            other = lists.facets.corner.mean(1)[partner]
        out[name] = (None, {"id": p.id[particle], "other": other, "spring": spring})
    skin = np.nan if lists.skin is None else lists.skin
    turned = np.array([getattr(wall, "turned", np.eye(3)) for wall in lists.walls])
    out["same"] = (None, {"step": c.step, "time": c.time, "turned": turned, "shape": lists.shape,
                          "motion": lists.motion, "skin": skin, "age": lists.age,
                          "rebuilds": lists.rebuilds, "known": c.layout == p.layout, "largest_overlap": c.largest_overlap})
    return out


def set_contacts(c, state):
    """Springs for the particles of this rank, given to the lists when these are made next; load the particles first."""
    lists, p, kept, same = c.lists, c.particles, [], state["same"]
    lists.shape[:], lists.motion[:] = same["shape"], same["motion"]
    lists.move_walls()
    for wall, row, turned in zip(lists.walls, lists.motion, same["turned"]):
        wall.point, wall.velocity, wall.angular_velocity = row[:3].copy(), row[3:6].copy(), row[6:].copy()
        if hasattr(wall, "turned"):
            wall.turned = turned
    lists.pose_surfaces()
    order = np.argsort(p.id)
    for name in ("pairs", "facets", "shapes"):
        rows = state[name]
        place = np.searchsorted(p.id[order], rows["id"])
        here = place < len(order)
        here[here] = p.id[order][place[here]] == rows["id"][here]
        other = rows["other"]
        if name == "facets" and len(other):
            other, found = nearest(lists.facets.corner.mean(1), other, None)
            here &= found
        kept.append(Kept(order[place[here]], other[here].astype(np.int64), rows["spring"][here].reshape(-1, lists.width)))
    lists.skin = None if np.isnan(same["skin"]) else float(same["skin"])
    lists.restored, lists.pairs = (kept, p.id.copy()), None
    lists.age, lists.rebuilds = int(same["age"]), int(same["rebuilds"])
    c.step, c.time, c.largest_overlap = int(same["step"]), float(same["time"]), float(same["largest_overlap"])
    c.layout = p.layout if same["known"] else None
    contacts_anew(c)


def contacts_anew(c):
    """Let the next step make the lists anew, as a run that goes on from a checkpoint does."""
    c.stale, c.lists.tile_layout, c.lists.wall_top = True, None, 0.0
    if c.layout != c.particles.layout:
        c.layout = None


FLUID_CELLS = ("gain", "fades", "drag_gain", "last_drag", "rate", "void_fraction", "_last_flux")
FLUID_NODES = ("nodal_velocity", "force", "nodal_gain", "slip_force", "past_pressures", "last_force", "last_change")


def fluid_state(air):
    """Fields of the fluid that the next step starts from."""
    n, own, d = air.num_cells, air.owned_nodes, air.dimension
    cells = {k: getattr(air, k) for k in FLUID_CELLS if getattr(air, k) is not None}
    nodes = {k: getattr(air, k)[:own] for k in FLUID_NODES if getattr(air, k) is not None}
    cells["velocity"], nodes["pressure"] = air.velocity.x.array.reshape(-1, d)[:n], air.pressure.x.array[:own]
    return {"cells": (air.corner.mean(1), cells), "nodes": (air.node_position[:own], nodes),
            "same": (None, {"time": air.time, "step": air.step, "dt": getattr(air, "dt", 0.0), "to_close": air._to_close,
                            "drag_known": air.drag_known, "guess_order": air.guess_order})}


def fluid_anew(air):
    """Let the next step make matrices and solvers anew, as a run that goes on from a checkpoint does."""
    air.as_new = True


def set_fluid(air, state):
    """Take the fields back."""
    n, own, d, same = air.num_cells, air.owned_nodes, air.dimension, state["same"]
    cells, nodes = state["cells"], state["nodes"]
    air.velocity.x.array.reshape(-1, d)[:n] = cells.pop("velocity")
    air.pressure.x.array[:own] = nodes.pop("pressure")
    air.velocity.x.scatter_forward()
    air.pressure.x.scatter_forward()
    fresh = air.memory_at_rest()
    for name in FLUID_CELLS:
        setattr(air, name, cells[name] if name in cells else fresh[name])
    for name in FLUID_NODES:
        value = nodes.get(name, fresh[name])
        if name in nodes:
            full = np.zeros((air.nodes, *value.shape[1:]))
            full[:own] = value
            value = air.node_halo.forward(full)
        setattr(air, name, value)
    air.drag_known = bool(same.get("drag_known", False))
    air.guess_order = int(same["guess_order"]) if "guess_order" in same else 0
    air.time, air.dt, air.step, air._to_close = (float(same["time"]), float(same["dt"]), int(same["step"]),
                                                 int(same["to_close"]))


def scalar_state(scalar):
    """The nodal values."""
    own, values = scalar.fluid.owned_nodes, {"value": scalar.value.x.array}
    if scalar.outside is not None:
        values["outside"] = scalar.outside
    return {"nodes": (scalar.fluid.node_position[:own], {name: a[:own] for name, a in values.items()})}


def set_scalar(scalar, state):
    """Take the values back."""
    air, nodes = scalar.fluid, state["nodes"]
    scalar.value.x.array[:air.owned_nodes] = nodes["value"]
    scalar.value.x.scatter_forward()
    scalar.outside = None
    if "outside" in nodes:
        scalar.outside = np.zeros(air.nodes)
        scalar.outside[:air.owned_nodes] = nodes["outside"]
        air.node_halo.forward(scalar.outside)


def scalar_anew(scalar):
    """Make the solver anew."""
    scalar.make_solver()


def inlet_state(inlet):
    """What waits, and the state of the random numbers."""
    return {"same": (None, {"inserted": inlet.inserted, "waiting": inlet.waiting,
                            "next": np.nan if inlet.next is None else inlet.next,
                            "generator": json.dumps(inlet.generator.bit_generator.state)})}


def set_inlet(inlet, state):
    """Take them back."""
    same = state["same"]
    inlet.inserted, inlet.waiting = int(same["inserted"]), float(same["waiting"])
    inlet.next = None if np.isnan(same["next"]) else float(same["next"])
    inlet.generator.bit_generator.state = json.loads(same["generator"])


def nearest(points, wanted, period):
    """Index of the point at each wanted place, and whether there is one within a millionth of the mesh; periodic boxes
    wrap."""
    from scipy.spatial import cKDTree  # where a checkpoint is loaded, nowhere else
    if not len(points) or not len(wanted):
        return np.zeros(len(wanted), np.int64), np.zeros(len(wanted), bool)
    size, box = np.ptp(points, 0).max() + np.abs(points).max(), None
    if period is not None and np.any(period):
        box = np.asarray(period, float)
        points, wanted = (np.where(box > 0, x - np.floor(x / np.where(box > 0, box, 1)) * box, x) for x in (points, wanted))
        points, wanted = (np.where((box > 0) & (x >= box), 0.0, x) for x in (points, wanted))
        lower = np.where(box > 0, 0.0, np.minimum(points.min(0), wanted.min(0)))  # the tree wants no negative places
        points, wanted = points - lower, wanted - lower
    distance, index = cKDTree(points, boxsize=box).query(wanted, distance_upper_bound=1e-6 * size)
    found = np.isfinite(distance)
    return np.where(found, index, 0), found


PARTS = {"Particles": (particles_state, set_particles), "Contacts": (contacts_state, set_contacts),
         "VolumeAveragedNavierStokes": (fluid_state, set_fluid), "Scalar": (scalar_state, set_scalar),
         "Inlet": (inlet_state, set_inlet)}


ANEW = {"Contacts": contacts_anew, "VolumeAveragedNavierStokes": fluid_anew, "Scalar": scalar_anew}


def make_anew(part):
    """Do what a run must do to be, from here on, the same to the last bit as one that goes on from its checkpoint."""
    if hasattr(part, "anew"):
        part.anew()
    for kind in type(part).__mro__:
        if kind.__name__ in ANEW:
            ANEW[kind.__name__](part)
