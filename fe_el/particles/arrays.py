"""The arrays of the particles, by name, and what follows from them."""
from typing import Any

import numpy as np
from mpi4py import MPI

from fe_el.parallel.exchange import total_of
from fe_el.particles import motion

FIELDS = {"position": (3,), "velocity": (3,), "angular_velocity": (3,), "diameter": (), "density": (), "force": (3,),
          "contact_force": (3,), "contact_torque": (3,), "mean_contact_force": (3,), "number": (), "relaxation_rate": ()}

INTEGERS = ("cell", "id", "material", "held")


class ParticleArrays:
    """What FIELDS and INTEGERS name, the arrays that users add, and what belongs to all particles alike."""

    mesh: Any
    comm: MPI.Comm
    gravity: np.ndarray  #: (3,) [m/s^2]
    period: np.ndarray | None  #: (3,) of the box, zero where it is not periodic [m]
    thickness: float  #: of a two-dimensional mesh [m]
    layout: int  #: changes with the number and the order of the rows

    position: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    diameter: np.ndarray
    density: np.ndarray
    force: np.ndarray
    contact_force: np.ndarray
    contact_torque: np.ndarray
    mean_contact_force: np.ndarray
    number: np.ndarray
    relaxation_rate: np.ndarray
    cell: np.ndarray
    id: np.ndarray
    material: np.ndarray
    held: np.ndarray
    properties: dict[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.id)

    @property
    def total_number(self) -> int:
        """Number of particles on all ranks."""
        return total_of(self.comm, len(self))

    @property
    def volume(self) -> np.ndarray:
        """(particles,) volume [m^3]."""
        return np.pi / 6 * (self.diameter * self.diameter * self.diameter)  # a power costs five times as much

    @property
    def coarse_graining(self) -> np.ndarray:
        """(particles,) diameter of each parcel over that of its particles: the cube root of ``number``."""
        return self.diameter / self.primary_diameter

    @property
    def primary_diameter(self) -> np.ndarray:
        """(particles,) diameter of the particles that each parcel stands for [m]; of a single particle its own."""
        return motion.primary_diameters(self.diameter, self.number)

    @property
    def mass(self) -> np.ndarray:
        """(particles,) mass [kg]."""
        return motion.masses(self.density, self.diameter)

    @property
    def inertia(self) -> np.ndarray:
        """(particles,) mass with the added mass, if there is one [kg]."""
        return self.mass + self.properties["added_mass"] if "added_mass" in self.properties else self.mass

    @property
    def late(self) -> np.ndarray:
        """(particles,) share of the coming step after which each particle comes in; without rows: all are here already."""
        return self.properties.get("_late", np.zeros(0))

    def speed(self) -> float:
        """Largest speed of a particle on this rank [m/s]. Not collective."""
        return float(np.sqrt(np.einsum("ij,ij->i", self.velocity, self.velocity).max(initial=0.0)))

    def arrays(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Names and arrays of everything that travels with a particle."""
        own = {name: getattr(self, name) for name in (*FIELDS, *INTEGERS)}
        return own, self.properties

    def select(self, rows: np.ndarray) -> None:
        """Keep the given rows, in that order."""
        for name in (*FIELDS, *INTEGERS):
            setattr(self, name, np.ascontiguousarray(getattr(self, name)[rows]))
        self.properties = {name: a[rows] for name, a in self.properties.items()}
        self.layout += 1
