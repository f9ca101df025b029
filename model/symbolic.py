"""Input of the code generator: a plant or a block as equations (CasADi functions) and FMI variables.

A plant is of second order in ``n`` unknown coordinates ``y`` (motion-driven plant: the elastic coordinates;
torque-driven plant: actuated and elastic coordinates)::

    r(y, y', y'', u, d) = M(y, u, d) y'' + b(y, y', u, d) = 0

with the inputs ``u`` and the derived values ``d``, computed once from the FMI parameters ``p``. The mass matrix M is
symmetric and positive definite; a build refuses one that isn't symmetric, or not the Jacobian of r by y''.

Any equations fit (`flexfmu.fmu_build.own_models` makes them of a user's): a state x of first order, x' = f, is the rate of an unknown
on whose coordinate, the integral of x, nothing depends; time is an unknown with the rate 1. Neither the integral nor time is a state
of the FMU. The unknowns are those of second order, those of first order, and time.

A block is a discrete-time system: a controller, shaper or imperfection. Its Python slave and its FMU have the same
equations, so their results are the same. At its sample instants t_k = offset + k * sample_time it reads its inputs u,
sets its outputs y and updates its states x::

    y_k = output(x_k, u_k, p)        x_{k+1} = update(x_k, u_k, p)

and holds y until the next instant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:  # code that only passes these types on doesn't load CasADi
    import casadi

    from flexfmu.trajectories.curves import Point

Causality = Literal["input", "parameter", "output"]

FUNCTION_SIGNATURES: Mapping[str, tuple[tuple[str, ...], str]] = {
    "derive": (("p",), "d"),
    "initial_inputs": (("p",), "u"),
    "initial_coordinates": (("p",), "start"),
    "start_forward": (("p", "dp"), "start_rates"),
    "residual": (("y", "v", "a", "u", "d"), "r"),
    "mass_matrix": (("y", "u", "d"), "m"),
    "outputs": (("y", "v", "a", "u", "d"), "o"),
    "motion_forward": (("y", "v", "a", "u", "d", "dy", "dv", "du", "dd"), "changes"),
    "motion_rate1": (("y", "v", "a", "u", "u1", "d"), "changes"),
    "motion_rate2": (("y", "v", "a", "u", "u1", "d", "j", "u2"), "rates2"),
    "singularity": (("y", "u", "d"), "margin"),
    "error_scale": (("d",), "scale"),
}
"""Name of each function → (arguments, result). See `fmu_build/c-runtime/base/model.h` for shapes and meaning."""

EVENT_SIGNATURES: Mapping[str, tuple[tuple[str, ...], str]] = {
    "event_numbers": (("y", "v", "a", "u", "d"), "crossings"),
    "event_resets": (("y", "v", "u", "d", "fired"), "motion"),
}
"""Further functions of a model with events."""


@dataclass(frozen=True)
class Variable:
    """A scalar FMI variable of the model.

    Attributes:
        name: structured FMI name, for example ``joint1.torque``.
        unit: unit in the spelling of `flexfmu.fmu_build.units`, for example ``N.m``; ``1`` for none.
        description: one sentence.
        causality: input, parameter or output.
        start: start value in ``unit`` (inputs and parameters; outputs are calculated and have none).
        minimum, maximum: admissible range in ``unit``; None where there is no limit.
        nominal: typical magnitude in ``unit``.
        derivative_of: name of the output whose time derivative this output is, or None.
        tunable: True for a parameter that may change between communication steps, False for one fixed after
            initialisation.
    """

    name: str
    unit: str
    description: str
    causality: Causality
    start: float | None = None
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    derivative_of: str | None = None
    tunable: bool = False


@dataclass(frozen=True)
class Friction:
    """Dry friction that can hold an unknown.

    In slip, its generalised force is a term of the unknown's row of the residual, with the direction d[direction]. In
    stiction, y'' = 0 replaces this row.

    Attributes:
        unknown: index in ``y``.
        breakaway: index in ``d`` of the largest generalised force that holds the unknown.
        direction: index in ``d`` of the direction of slip, 1 or -1, set by the runtime; 0, the value of `derive`,
            stands for the sign of the rate.
    """

    unknown: int
    breakaway: int
    direction: int


@dataclass(frozen=True)
class Event:
    """A number whose passage through zero changes the equations or the states.

    Attributes:
        side: index in ``d`` of the number's sign, 1 or -1, set by the runtime; it changes at passages only.
        direction: of the passages that reset states: 1 upwards, -1 downwards, 0 both.
        has_reset: whether states are reset.
        is_instant: whether the number moves at a constant rate between events, so that the time of the next one is known.
        at_start: whether an event that is past at the start happens there, as samples do.
        name: for messages.
    """

    side: int
    direction: int
    has_reset: bool
    is_instant: bool = False
    at_start: bool = False
    name: str = ""


@dataclass(frozen=True)
class EffectNote:
    """Documentation of an effect.

    Attributes:
        title: name of the effect.
        sentence: description in one sentence.
        formula: energy or dissipation function as text; may be empty.
        contributes: parts of the model that the effect contributes to; they follow from its hooks.
    """

    title: str
    sentence: str
    formula: str = ""
    contributes: tuple[str, ...] = ()


Part = Literal["proximal", "distal", "motor", "joint", "end effector"]


@dataclass(frozen=True)
class Bar:
    """A link of a drawing.

    Attributes:
        name: name of the link, as in the variables.
        part: kind of link.
        start, end: ends of the link [m].
        diameter: outer diameter [m].
    """

    name: str
    part: Part
    start: Point
    end: Point
    diameter: float


@dataclass(frozen=True)
class Spot:
    """A named point of a drawing; position in m."""

    name: str
    part: Part
    position: Point


@dataclass(frozen=True)
class Drawing:
    """A mechanism in its start pose, for figures."""

    bars: tuple[Bar, ...]
    spots: tuple[Spot, ...]


@dataclass(frozen=True)
class SymbolicModel:
    """A plant as equations and variables; immutable. `flexfmu.fmu_build` generates C from it.

    Attributes:
        name: model name, a C identifier after `flexfmu.fmu_build` has cleaned it.
        description: one sentence for the model description.
        unknowns: names of the ``n`` unknown coordinates, in the order of ``y``.
        inputs, parameters, outputs: variables in the order of ``u``, ``p`` and ``o``.
        functions: one CasADi function for each entry of `FUNCTION_SIGNATURES`, all arguments and results dense.
        acceleration_terms: (output, unknown) of each entry of do/da, in the order in which `motion_rate1` gives them.
        feedthrough: output → inputs that it depends on algebraically (direct feedthrough).
        static_start: start value of the FMI parameter ``initial``: True for static equilibrium, False for undeformed.
        margin_name: quantity that `singularity` returns, for messages.
        minimum_margin: smallest admissible value of that quantity.
        is_damped: whether an effect damps vibrations; if none does, the integrator must not damp them either.
        locked: number of leading unknowns that are actuated. They start at `initial_coordinates` and stay there in the
            static equilibrium of the others. The input of the same index is their generalised force; by default it
            holds the equilibrium.
        rate_inputs: number of trailing inputs that are rates or accelerations; they are zero in the static equilibrium.
        twin_unknowns, twin_inputs: (first, second) for each pair of unknowns and of inputs of two equal parts, as the legs
            of a robot; the generated code computes both parts at once.
        frictions: dry friction that can hold unknowns; events switch between stiction and slip.
        events: numbers whose passages through zero are events.
        effects: documentation of the effects in the model.
        drawing: drawing of the mechanism, or None.
        pose: names of the outputs that give the pose in messages.
        first_order: number of unknowns of first order; their names are those of their rates, the states.
        has_clock: whether the last unknown is the time.
        nominals: usual sizes of the states, positive, in their order; the tolerance is relative to them, or to the largest value that a
            state has had. Empty for a model with an error norm of its own, at rest at the start; otherwise
            `initial_coordinates` gives the rates behind the coordinates.
        iterated: names of the outputs for which the equations solve by iteration; where it fails they give no number.
    """

    name: str
    description: str
    unknowns: tuple[str, ...]
    inputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    functions: Mapping[str, casadi.Function]
    acceleration_terms: tuple[tuple[int, int], ...]
    feedthrough: Mapping[str, tuple[str, ...]]
    static_start: bool
    margin_name: str
    minimum_margin: float
    is_damped: bool = False
    locked: int = 0
    rate_inputs: int = 0
    twin_unknowns: tuple[tuple[int, int], ...] = ()
    twin_inputs: tuple[tuple[int, int], ...] = ()
    frictions: tuple[Friction, ...] = ()
    events: tuple[Event, ...] = ()
    effects: tuple[EffectNote, ...] = ()
    drawing: Drawing | None = None
    pose: tuple[str, ...] = ()
    first_order: int = 0
    has_clock: bool = False
    nominals: tuple[float, ...] = ()
    iterated: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Return a line: the names of its unknowns and inputs."""
        names = ", ".join(self.unknowns), ", ".join(each.name for each in self.inputs) or "none"
        return f"Model {self.name}: unknowns {names[0]}; inputs {names[1]}; {len(self.outputs)} outputs"

    @property
    def states(self) -> tuple[int, ...]:
        """Which of [y, v] (2 n) are states."""
        n = self.degrees_of_freedom
        rates = n - self.has_clock
        return (*range(rates - self.first_order), *range(n, n + rates))

    @property
    def degrees_of_freedom(self) -> int:
        """Number of unknown coordinates n."""
        return len(self.unknowns)


@dataclass(frozen=True)
class SharedLibrary:
    """A shared library of a user that a block's functions call.

    Attributes:
        content: the file.
        function: name of the function that is called.
    """

    content: bytes
    function: str


@dataclass(frozen=True)
class SymbolicBlock:
    """A block as equations and variables; immutable.

    Attributes:
        name: model name.
        description: one sentence.
        sample_time: sample time [s], above zero; infinite for a block that samples at ``instants`` alone.
        offset: first sample instant [s], zero or positive.
        instants: further sample instants after the start [s], ascending.
        inputs, outputs, parameters: variables in the order of u, y and p.
        states: start values of the states x.
        output: CasADi function (x, u, p) → y, all dense column vectors.
        update: CasADi function (x, u, p) → next x.
        feedthrough: output → inputs that it depends on at the same instant (direct feedthrough).
        latency: output → its delay at low frequency [s], without the hold; outputs without a delay are left out.
        c_files: C files and headers that the functions call as `casadi.external`, name → text; compiled into the block's FMU.
        libraries: shared libraries for this platform that the C files call, name of the file → library; copied into the FMU.
    """

    name: str
    description: str
    sample_time: float
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    output: casadi.Function
    update: casadi.Function
    parameters: tuple[Variable, ...] = ()
    states: tuple[float, ...] = ()
    offset: float = 0.0
    feedthrough: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    latency: Mapping[str, float] = field(default_factory=dict)
    c_files: Mapping[str, str] = field(default_factory=dict)
    libraries: Mapping[str, SharedLibrary] = field(default_factory=dict)
    instants: tuple[float, ...] = ()
