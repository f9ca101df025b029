"""What the code generator takes: a plant or a block as equations (CasADi functions) with the variables that a user sees.

A plant is of second order in ``n`` unknown coordinates ``y`` (motion-driven plant: the elastic coordinates;
torque-driven plant: actuated and elastic coordinates)::

    r(y, y', y'', u, d) = M(y, u, d) y'' + b(y, y', u, d) = 0

with the inputs ``u`` and the derived values ``d``, which follow from the FMI parameters ``p`` once.

A block is a discrete-time system: a controller, shaper or imperfection, from which both its Python slave and its FMU
are made, so that they give the same numbers. At its sample instants t_k = offset + k * sample_time it reads its inputs
u, outputs y and updates its states x::

    y_k = output(x_k, u_k, p)        x_{k+1} = update(x_k, u_k, p)

and keeps y until the next instant.
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
    "initial_coordinates": (("p",), "y"),
    "start_forward": (("p", "dp"), "start_rates"),
    "residual": (("y", "v", "a", "u", "d"), "r"),
    "mass_matrix": (("y", "u", "d"), "m"),
    "outputs": (("y", "v", "a", "u", "d"), "o"),
    "motion_forward": (("y", "v", "a", "u", "d", "dy", "dv", "du", "dd"), "changes"),
    "motion_rate2": (("y", "v", "a", "j", "u", "u1", "u2", "d"), "rates2"),
    "singularity": (("y", "u", "d"), "margin"),
    "error_scale": (("d",), "scale"),
}
"""Name of each function → (arguments, result). See `fmu_build/c-runtime/model.h` for shapes and meaning."""


@dataclass(frozen=True)
class Variable:
    """A scalar variable of the model as FMI shows it.

    Attributes:
        name: structured FMI name, for example ``joint1.torque``.
        unit: unit in the spelling of `flexfmu.fmu_build.units`, for example ``N.m``; ``1`` for none.
        description: one sentence.
        causality: input, parameter or output.
        start: start value in ``unit`` (inputs and parameters; outputs are calculated and have none).
        minimum, maximum: admissible range in ``unit``; None where there is no limit.
        nominal: typical magnitude in ``unit``.
        derivative_of: name of the output whose time derivative this output is; None otherwise.
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

    While it slips, its generalised force is a term of the residual's row of that unknown, with its direction
    d[direction]; while it sticks, the row is y'' = 0 instead.

    Attributes:
        unknown: index in ``y``.
        breakaway: index in ``d`` of the largest generalised force that holds the unknown.
        direction: index in ``d`` of the direction of slip, 1 or -1, which the runtime sets; 0, as `derive` gives it, stands
            for the sign of the rate.
    """

    unknown: int
    breakaway: int
    direction: int


@dataclass(frozen=True)
class EffectNote:
    """What the documentation says of an effect.

    Attributes:
        title: what it is called.
        sentence: what it is.
        formula: its energy or dissipation as a person writes it; may be empty.
        contributes: to which parts of the model.
    """

    title: str
    sentence: str
    formula: str = ""
    contributes: tuple[str, ...] = ()


Part = Literal["proximal", "distal", "motor", "joint", "end effector"]


@dataclass(frozen=True)
class Bar:
    """A link.

    Attributes:
        name: as the variables call it.
        part: which kind of link.
        start, end: its ends [m].
        diameter: [m].
    """

    name: str
    part: Part
    start: Point
    end: Point
    diameter: float


@dataclass(frozen=True)
class Spot:
    """A point with a name, [m]."""

    name: str
    part: Part
    position: Point


@dataclass(frozen=True)
class Drawing:
    """A mechanism in its start pose, for pictures of it."""

    bars: tuple[Bar, ...]
    spots: tuple[Spot, ...]


@dataclass(frozen=True)
class SymbolicModel:
    """A plant as equations and variables; a pure value that `flexfmu.fmu_build` turns into C.

    Attributes:
        name: model name, a C identifier after `flexfmu.fmu_build` has cleaned it.
        description: one sentence for the model description.
        unknowns: names of the ``n`` unknown coordinates, in the order of ``y``.
        inputs, parameters, outputs: variables in the order of ``u``, ``p`` and ``o``.
        functions: one CasADi function for each entry of `FUNCTION_SIGNATURES`, all arguments and results dense.
        acceleration_terms: (output, unknown) of each entry of do/da, in the order in which `motion_forward` gives them.
        feedthrough: for each output the names of the inputs that it depends on algebraically.
        static_start: start value of the FMI parameter ``initial``: True for static equilibrium, False for undeformed.
        margin_name: what `singularity` measures, with its unit, for messages.
        minimum_margin: smallest admissible value of that measure.
        is_damped: whether any effect dissipates the energy of vibrations; where none does, the integrator must not either.
        locked: number of leading unknowns that are actuated: they start at `initial_coordinates`, are held there while
            the others find their static equilibrium, and each belongs to the input of the same index, a generalised
            force that holds the equilibrium unless it is set.
        rate_inputs: number of trailing inputs that are rates: zero at rest, so the static equilibrium doesn't see them.
        frictions: dry friction that can hold unknowns; events within a motion change what it does.
        effects: what the model contains, for documentation.
        drawing: what the mechanism looks like; None where there is nothing to draw.
        pose: names of the outputs that say where the mechanism is, for messages.
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
    frictions: tuple[Friction, ...] = ()
    effects: tuple[EffectNote, ...] = ()
    drawing: Drawing | None = None
    pose: tuple[str, ...] = ()

    @property
    def degrees_of_freedom(self) -> int:
        """Number of unknown coordinates n."""
        return len(self.unknowns)


@dataclass(frozen=True)
class SymbolicBlock:
    """A block as equations and variables; a pure value.

    Attributes:
        name: model name.
        description: one sentence.
        sample_time: [s], above zero.
        offset: first sample instant [s], zero or positive.
        inputs, outputs, parameters: variables in the order of u, y and p.
        states: start values of the states x.
        output: CasADi function (x, u, p) → y, all dense column vectors.
        update: CasADi function (x, u, p) → next x.
        feedthrough: for each output the names of the inputs that it depends on at the same instant.
        latency: for outputs that are delayed on purpose by how much they lag at low frequency [s], without the hold.
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
