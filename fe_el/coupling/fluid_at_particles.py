"""What forces ask of the fluid: quantities of its cells, mapped to the particles, in one exchange for all forces of a list.

A force of the list is any object with a tuple ``needs`` of names below and one or more of the methods

    force(fluid)             (particles, d) force on each particle over the step [N]
    drag_coefficient(fluid)  (particles,) coefficient beta per particle volume [kg/(m^3 s)] of a drag V beta (u - v), added
                             to that of :class:`Drag` and taken implicitly like it
    spin(fluid)              (particles,) rate [1/s] and (particles, 3) target [1/s] of angular velocities that relax

where ``fluid`` is a :class:`FluidAtParticles`. The fluid receives the opposite of what particles get, by the same map.
"""
import numpy as np
from dolfinx import fem
from dolfinx import mesh as dmesh

from fe_el.coupling.smoothing import Nodes
from fe_el.parallel.exchange import raise_everywhere

METHODS = ("force", "drag_coefficient", "spin")


class FluidAtParticles:
    """The fluid at the particles at the start of a step, as a force of the list sees it; d is the dimension.

    Attributes:
        particles (Particles): the particles; their own arrays, such as ``particles.angular_velocity``.
        dt (float): the step [s].
        span: (particles,) the part of it in which a particle is there: less than ``dt`` for one that comes in late [s].
        density, viscosity (float): of the fluid [kg/m^3], [Pa s].
        volume: (particles,) volumes [m^3].
        velocity: (particles, d) [m/s], and the rest if the force ``needs`` them:
        slip: (particles, d) fluid velocity less particle velocity [m/s].
        solid_fraction: (particles,).
        velocity_gradient: (particles, d, d) du_k/dx_l [1/s].
        vorticity: (particles, 3) curl u [1/s].
        pressure_gradient: (particles, d) gradient of the solved pressure [Pa/m].
        stress_divergence: (particles, d) div tau of the viscous stress [N/m^3].
    """

    def __init__(self, particles, dt, density, viscosity, volume, quantities):
        self.particles, self.dt, self.density, self.viscosity, self.volume = particles, dt, density, viscosity, volume
        self.span = dt * (1 - particles.late) if len(particles.late) else np.full(len(particles), dt)
        self.__dict__.update(quantities)

    def __getattr__(self, name):
        known = f"a force names in ``needs`` what it asks of the fluid, of {', '.join(NEEDS)}"
        raise AttributeError(f"{name!r} is not at hand at the particles; {known}.")


NEEDS = ("velocity", "slip", "solid_fraction", "velocity_gradient", "vorticity", "pressure_gradient", "stress_divergence")


def check_force(force):
    """Refuse what is no force of the open list.

    Raises:
        ValueError: for an object without one of the methods, or with unknown needs.
    """
    if not any(callable(getattr(force, name, None)) for name in METHODS) or isinstance(force, type):
        raise ValueError(f"{force!r} is no force; forces are Drag(law), PressureGradient(), ViscousStress(), Buoyancy(), "
                         f"and objects with a tuple needs and a method of {', '.join(METHODS)}.")
    unknown = [name for name in getattr(force, "needs", ()) if name not in NEEDS]
    if unknown:
        raise ValueError(f"The force {force!r} needs {unknown[0]!r}, which is not known; it may need {', '.join(NEEDS)}.")


def given(force, method, fluid, shape):
    """What a method of a force gives for a :class:`FluidAtParticles`, of the right shape and finite. Collective.

    Raises:
        ValueError, FloatingPointError: on all ranks.
    """
    p, name = fluid.particles, f"{type(force).__name__}.{method}"
    values = np.asarray(getattr(force, method)(fluid), float)
    message = f"{name} gave an array of shape {values.shape}; it must be {shape}." if values.shape != shape else None
    raise_everywhere(p.comm, ValueError, message)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=tuple(range(1, values.ndim))))
    if len(bad):
        message = (f"{name} gave {values[bad[0]].tolist()} for particle {p.id[bad[0]]} (step {p.step}, rank {p.comm.rank}); "
                   "it must be finite.")
    raise_everywhere(p.comm, FloatingPointError, message)
    return values


class AskedOfFluid:
    """Cell columns of all that the forces of a list need, and how the particles' means of them are told apart.

    Args:
        mesh: dolfinx mesh.
        needs: names of :data:`NEEDS`.
        viscosity (float): of the fluid [Pa s].
        gradient_mean: gives the cell means of the pressure gradient; used if it is needed.

    Note:
        Collective.
    """

    def __init__(self, mesh, needs, viscosity, gradient_mean):
        self.needs, d = set(needs), mesh.topology.dim
        self.gradient_mean, self.solid = gradient_mean, "solid_fraction" in self.needs
        self.velocity = bool({"velocity", "slip"} & self.needs)
        self.slope = VelocityGradient(mesh) if {"velocity_gradient", "vorticity"} & self.needs else None
        self.stress = ViscousStressMean(mesh, viscosity) if "stress_divergence" in self.needs else None
        self.dimension = d

    def columns(self, cell_velocity):
        """(owned cells, k) of what passes the maps, velocities first."""
        out = [cell_velocity] if self.velocity else []
        out += [self.slope(cell_velocity).reshape(len(cell_velocity), -1)] if self.slope is not None else []
        out += [self.gradient_mean()] if "pressure_gradient" in self.needs else []
        out += [self.stress(cell_velocity)] if self.stress is not None else []
        return np.hstack(out) if out else np.zeros((len(cell_velocity), 0))

    def quantities(self, means, solid, velocity):
        """Arrays by name, from the particles' means of the columns, of the solid fraction, and their velocities."""
        out, d, at = {}, self.dimension, 0
        if self.solid:
            out["solid_fraction"] = solid[:, 0]
        if self.velocity:
            out["velocity"], at = means[:, :d], d
            out["slip"] = means[:, :d] - velocity
        if self.slope is not None:
            slope, at = means[:, at:at + d * d].reshape(-1, d, d), at + d * d
            out["velocity_gradient"], out["vorticity"] = slope, curl(slope)
        for name in ("pressure_gradient", "stress_divergence"):
            if name in self.needs:
                out[name], at = means[:, at:at + d], at + d
        return out


def curl(slope):
    """Vorticity (n, 3) of velocity gradients (n, d, d), [:, k, l] = du_k/dx_l; in two dimensions along z."""
    out = np.zeros((len(slope), 3))
    out[:, 2] = slope[:, 1, 0] - slope[:, 0, 1]
    if slope.shape[1] == 3:
        out[:, 0], out[:, 1] = slope[:, 2, 1] - slope[:, 1, 2], slope[:, 0, 2] - slope[:, 2, 0]
    return out


class VelocityGradient:
    """Gradients of a cell velocity: of the linear function through the means of the cells around each vertex.

    These means belong to the centroids of the cells that they are taken from, which beside boundaries are not the vertices:
    so the gradient of a linear velocity is exact in every cell.

    Note:
        Collective.
    """

    def __init__(self, mesh):
        self.nodes = nodes = Nodes(mesh)
        self.mass = nodes.node_halo.forward(nodes.load(np.ones((len(nodes.dofs), 1))))
        m, d = nodes.dofs.shape[1], nodes.gradient.shape[2]
        edges = np.linalg.inv(nodes.gradient[:, 1:]).transpose(0, 2, 1)  # from the first vertex to the others
        corner = np.concatenate([np.zeros((len(edges), 1, d)), edges], 1)
        way = corner.mean(1, keepdims=True) - corner
        total = np.zeros((nodes.nodes, d))
        np.add.at(total, nodes.dofs, way * (nodes.volume / m)[:, None, None])
        nodes.node_halo.complete(total)
        away = (total / self.mass)[nodes.dofs]
        self.inverse = np.linalg.inv(np.eye(d) + np.einsum("cik,cil->ckl", away, nodes.gradient))

    def __call__(self, velocity):
        """(owned cells, d, d) du_k/dx_l [1/s]."""
        nodes = self.nodes
        u = (nodes.node_halo.forward(nodes.load(velocity)) / self.mass)[nodes.dofs]
        return np.einsum("cik,cim,cml->ckl", u, nodes.gradient, self.inverse, optimize=True)


class ViscousStressMean:
    """Cell means of div tau = mu laplace u, from the nodal means of a cell velocity; zero at the nodes of the boundary."""

    def __init__(self, mesh, viscosity):
        self.nodes, self.viscosity = Nodes(mesh), viscosity
        self.mass = self.nodes.node_halo.forward(self.nodes.load(np.ones((len(self.nodes.dofs), 1))))
        self.inside = inner_nodes(self.nodes, mesh)

    def __call__(self, velocity):
        """(owned cells, d) [N/m^3]."""
        nodes = self.nodes
        u = nodes.node_halo.forward(nodes.load(velocity)) / self.mass
        slope = np.einsum("cik,cid->ckd", nodes.gradient, u[nodes.dofs])
        flux = np.einsum("cik,ckd,c->cid", nodes.gradient, slope, nodes.volume)
        out = np.zeros_like(u)
        np.add.at(out, nodes.dofs, -self.viscosity * flux)
        nodes.node_halo.complete(out)
        return nodes.means(np.where(self.inside[:, None], out / self.mass, 0.0))


def inner_nodes(nodes, mesh):
    """(nodes,) whether a node lies off the boundary. Collective."""
    mark, d = np.zeros(nodes.nodes), mesh.topology.dim
    mesh.topology.create_connectivity(d - 1, d)
    outer = dmesh.exterior_facet_indices(mesh.topology)
    mark[fem.locate_dofs_topological(nodes.space, d - 1, outer)] = 1.0
    return nodes.node_halo.forward(nodes.node_halo.reverse_add(mark)) == 0
