"""What the loops of the cell-node scheme are given, by name; n cells, m nodes, d dimensions.

Loops take the arrays that they need out of a record before they begin.
"""
from typing import NamedTuple

import numpy as np


class Step(NamedTuple):
    """Numbers of a step."""

    dt: float  #: [s]
    density: float  #: [kg/m^3]
    nu: float  #: kinematic viscosity [m^2/s]
    upwind: bool


class Masses(NamedTuple):
    """Masses of the fluid in the cells [kg]."""

    before: np.ndarray  #: (n,)
    after: np.ndarray  #: (n,)


class Void(NamedTuple):
    """The void fraction at the end of the step, and its rate."""

    fraction: np.ndarray  #: (n,)
    rate: np.ndarray  #: (n,) [1/s]


class Memory(NamedTuple):
    """What the nodes do not carry, and what feeds and fades it; gains and fades are those of the last step."""

    gain: np.ndarray  #: (n, d) acceleration of the cells by drag and pressure [m/s^2]
    nodal_gain: np.ndarray  #: (m, d) the nodes' part [m/s^2]
    fades: np.ndarray  #: (n, d) what faded per time [m/s^2]
    left: np.ndarray  #: (n,) part that is left after the step
    lag: np.ndarray  #: (n,) time of the step in which the gain does not fade, as it acts at the end [s]


class Drag(NamedTuple):
    """What transport makes of drag and of gains."""

    split: np.ndarray  #: (n,) share of viscosity in the fading
    stay: np.ndarray  #: (n,) time of the step in which a gain has not faded at its end [s]
    part: np.ndarray  #: (n,) of the mean nodal velocity that comes off the gain by drag [1/s]
    mobility: np.ndarray  #: (n,) gain by minus a pressure gradient, less what drag takes of it [m^3/kg]
    reach: np.ndarray  #: (n,) of a gain that reaches the nodes, times mass [kg]
    pressure: np.ndarray  #: (m,) of the last step, but that of now at outlets [Pa]


class Faded(NamedTuple):
    """Nodal sums of fading."""

    mass: np.ndarray  #: (m,) at the end of the step [kg]
    defect: np.ndarray  #: (m, d) momentum that faded, but for what the nodes have had in their transport [kg m/s]


class Exchange(NamedTuple):
    """What acts on the cells in the exchange."""

    part: np.ndarray  #: (n,) share of pressure gradient and body force that the fluid takes
    supply: np.ndarray  #: (n,) volume that the cells give off per volume and time [1/s]
    drag: np.ndarray  #: (n,) [kg/(m^3 s)]
    source: np.ndarray  #: (n, d) [N/m^3]
    body: np.ndarray  #: (n or 1, d) body force [N/m^3]


class SolidsAnswer(NamedTuple):
    """What the solids' volume flux (1 - phi) v answers within a step to what the fluid does in it."""

    to_velocity: np.ndarray  #: (n,) change of the flux over that of the fluid's velocity
    to_gradient: np.ndarray  #: (n,) over that of minus the pressure gradient [m^3 s/kg]


class PressureSystem(NamedTuple):
    """Eliminated cells, and the Poisson equation that follows."""

    diagonal: np.ndarray  #: (n,) rho phi / dt + A
    weight: np.ndarray  #: (n,) of the equation, with the cell's volume
    rhs: np.ndarray  #: (m,)


class Load(NamedTuple):
    """What acts on the nodes in transport [N]."""

    force: np.ndarray  #: (m, d) given beforehand
    explicit: np.ndarray  #: (m, d) by the velocity before
    lift: np.ndarray  #: (m, d) by the nodes that boundaries hold


class Held(NamedTuple):
    """Nodes that boundaries hold."""

    nodes: np.ndarray
    values: np.ndarray  #: (m, d) of all nodes; those of others do not count


class NodalSystem(NamedTuple):
    """Right-hand side of transport, the systems of its components, and guesses of their solutions."""

    rhs: np.ndarray  #: (m, d)
    system: np.ndarray  #: (d, owned nodes)
    guess: np.ndarray  #: (d, owned nodes)
