"""What a step of the fluid takes over from the last, and what its stages hand to each other."""
from dataclasses import dataclass, field

import numpy as np

from fe_el.fluid.records import Exchange, Masses, Memory, SolidsAnswer, Step

CELLS = ("gain", "fades", "rate", "void_fraction", "last_flux")
NODES = ("nodal_velocity", "force", "nodal_gain", "slip_force", "past_pressures", "last_force", "last_change")
NUMBERS = {"dt": float, "to_close": int, "guess_order": int}


class FluidState:
    """What a step takes over from the last, beside velocity, pressure and time; n cells, m nodes, d dimensions.

    Attributes:
        dt (float): the last step [s].
        void_fraction: (n,) at its end; ``None``: there was none.
        rate: (n,) of the void fraction in it [1/s].
        last_flux: (n, d) mass flux rho phi u at its start [kg/(m^2 s)]; ``None``: there was none.
        to_close (int): steps whose mass flux is still to be closed.
        gain: (n, d) acceleration of the cells by drag and pressure [m/s^2]; nodal_gain: (m, d) the nodes' part.
        fades: (n, d) what faded per time of what the nodes do not carry [m/s^2].
        nodal_velocity: (m, d) [m/s]; ``None``: the next step starts with means of the cells.
        last_change: (m, d) of the nodal velocity by transport [m/s], for a guess of the next.
        force: (m, d) that drag and pressure gave [N]; last_force: that transport was given in the last step, of the step
            before; ``None``: none, or drag took part in it.
        slip_force: (m, d) that keeps the flow along slip walls [N].
        past_pressures: (m, 3) before the last [Pa]; guess_order (int): in which they are extrapolated.
    """

    void_fraction: np.ndarray | None
    last_flux: np.ndarray | None
    nodal_velocity: np.ndarray | None
    last_force: np.ndarray | None

    def __init__(self, n: int, m: int, d: int) -> None:
        self.void_fraction = self.last_flux = self.nodal_velocity = self.last_force = None
        self.dt, self.to_close, self.guess_order = 0.0, 0, 0
        self.rate, self.past_pressures = np.zeros(n), np.zeros((m, 3))
        self.gain, self.fades = np.zeros((n, d)), np.zeros((n, d))
        self.force, self.nodal_gain, self.slip_force, self.last_change = (np.zeros((m, d)) for _ in range(4))

    def saved(self, owned_nodes: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], dict[str, float]]:
        """Arrays of the cells, of the owned nodes, and numbers, by name."""
        cells = {k: getattr(self, k) for k in CELLS if getattr(self, k) is not None}
        nodes = {k: getattr(self, k)[:owned_nodes] for k in NODES if getattr(self, k) is not None}
        return cells, nodes, {k: getattr(self, k) for k in NUMBERS}

    def restore(self, cells: dict[str, np.ndarray], nodes: dict[str, np.ndarray], numbers: dict[str, float]) -> None:
        """Take back what is there by name, into a state at rest; ``nodes`` are all nodes of the rank."""
        for name in (*CELLS, *NODES):
            value = cells.get(name, nodes.get(name))
            if value is not None:
                setattr(self, name, value)
        for name, kind in NUMBERS.items():
            if name in numbers:
                setattr(self, name, kind(numbers[name]))


@dataclass(slots=True, eq=False)
class StepState:
    """A step, handed from stage to stage: each takes what those before it have left and leaves its own.

    Its arrays are used again two steps later at the latest.
    """

    # what the step is given and starts from
    numbers: Step
    single_phase: bool  #: no particles: a void fraction of one
    before: np.ndarray  #: (n,) void fraction at the start
    after: np.ndarray  #: (n,) and at the end
    rate: np.ndarray  #: (n,) of its change [1/s]
    last_rate: np.ndarray  #: (n,) that of the last step [1/s]
    drag: np.ndarray  #: (n,) coefficient A [kg/(m^3 s)]
    source: np.ndarray  #: (n, d) B [N/m^3]
    share: np.ndarray  #: (n,) of pressure gradient and body force that the fluid takes
    handed: np.ndarray | None  #: (n,) of the gradient of the solved pressure, which light particles hand on; None: none
    answer: SolidsAnswer | None  #: of crowded particles that move with the fluid; None: none
    velocity: np.ndarray  #: (n, d) q, of the cells at the start [m/s]
    masses: Masses  #: of the cells
    damping: np.ndarray  #: (n,) part of the velocity that drag takes
    memory: Memory
    moves: bool  #: whether the void fraction changes anywhere on this rank
    second_order: bool = field(init=False)  #: in time
    drag_inside: bool = field(init=False)  #: whether transport knows of drag and sources
    # mass flux
    flux: np.ndarray = field(init=False)  #: (n, d) [kg/(m^2 s)]
    # 1. relaxation
    nodal_velocity: np.ndarray = field(init=False)  #: (m, d) u, relaxed [m/s]
    nodal_mass_before: np.ndarray = field(init=False)  #: (m,) at the start [kg]
    # 2. transport and 3. fading
    stress: np.ndarray = field(init=False)  #: (n,) viscosity times the cells' share of the stress [Pa s]
    nodal_mass: np.ndarray = field(init=False)  #: (m,) at the end [kg]
    acting: Exchange = field(init=False)  #: what acts on the cells, that of layers which the mesh does not resolve included
    inflow: np.ndarray = field(init=False)  #: (m,) volume per time that inlets let in, at the end [m^3/s]
    pressure_iterations: int = 0  #: that found the pressure within transport, of a transport solve and a multigrid cycle
    kept: np.ndarray = field(init=False)  #: (n, d) what cells have beside their nodes, then all of their velocity [m/s]
    transported: np.ndarray = field(init=False)  #: (m, d) nodal velocity [m/s]
    correction: np.ndarray = field(init=False)  #: (m, d) what closes the balance of transport on held nodes [m/s]
    reaction: np.ndarray = field(init=False)  #: (m, d) what walls add to hold their nodes [N]
    given: np.ndarray = field(init=False)  #: (m, d) force of drag and pressure that transport was given [N]
    taken: np.ndarray = field(init=False)  #: (m, d) what of it was taken off again [N]
    # 4. projection
    answered: np.ndarray = field(init=False)  #: (n, d) by how much the solids' volume flux has changed [m/s], if they answer

    @property
    def dt(self) -> float:
        """The step [s]."""
        return self.numbers.dt
