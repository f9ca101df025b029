"""The variables of a model description: value references, causality, variability and dependencies.

The continuous states of a plant are x = [y, dy/dt]. In the model description each state is a local variable, an alias of its output.
FMI allows an output that is itself a state, but Maestro 3.1.1 fails where a state and its derivative are both connected outputs
(ClassCastException in ComponentVariableFmi2Api.share), and controllers usually take position and velocity.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite, sqrt
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from flexfmu.fmu_build.choices import FIXED_STEP, INITIAL, INTEGRATOR, INTEGRATOR_REFERENCE, ChoiceParameter
from flexfmu.fmu_build.errors import ModelError, StartError
from flexfmu.fmu_build.units import DIMENSIONLESS, display_unit, quantity
from flexfmu.model.symbolic import Variable

if TYPE_CHECKING:
    import casadi

    from flexfmu.model.symbolic import SymbolicModel

T = TypeVar("T")

STATISTICS: Mapping[str, str] = {
    "statistics.steps": "Accepted steps of the integrator since initialisation",
    "statistics.rejections": "Rejected steps of the integrator since initialisation",
    "statistics.evaluations": "Evaluations of the equations of motion since initialisation",
    "statistics.iterations": "Iterations for the stage equations since initialisation",
    "statistics.factorisations": "Factorisations of the iteration matrix since initialisation",
}
"""Counters of the integrator, in the order of their value references."""


@dataclass(frozen=True)
class FmiVariable:
    """A scalar variable of the model description; attributes are spelt as in the FMI 2.0 standard.

    Attributes:
        value_reference: value reference, from 0 for each type.
        kind: FMI type.
        start: start value; None where the standard forbids one.
        declared_type: name of the type, which is the physical quantity.
        unit, display_unit: None for dimensionless variables.
        derivative: name of the continuous state of which this variable is the time derivative.
        size: number of elements; more than one make an array, which FMI 2.0 doesn't have.
    """

    name: str
    value_reference: int
    kind: Literal["Real", "Integer", "Clock"]
    description: str
    causality: str
    variability: str
    initial: str | None = None
    start: float | int | None = None
    declared_type: str | None = None
    unit: str | None = None
    display_unit: str | None = None
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    derivative: str | None = None
    size: int = 1


@dataclass(frozen=True)
class Interface:
    """All variables of an FMU and the model structure, by structured names.

    Attributes:
        variables: in the order of the model description: inputs, parameters, states, outputs, variables of other types.
            Each derivative follows its state, otherwise OMSimulator 3.0 fails.
        outputs: output → the inputs and states that it depends on.
        initial_unknowns: what initialisation calculates: states and outputs.
        initial_knowns: the inputs and parameters on which all of these depend.
        derivatives: the state derivatives among the outputs, in the order of the states.

    Raises:
        ModelError: a name is repeated.
    """

    variables: tuple[FmiVariable, ...]
    outputs: Mapping[str, tuple[str, ...]]
    initial_unknowns: tuple[str, ...]
    initial_knowns: tuple[str, ...]
    derivatives: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        twice = [name for name, count in Counter(each.name for each in self.variables).items() if count > 1]
        if twice:
            raise ModelError(f"variable '{twice[0]}' is there more than once; names must be unique")

    def structure(self, numbers: Mapping[str, int] | None = None) -> dict[str, dict[int, list[int]]]:
        """Parts of the model structure: name → number of each unknown → numbers that it depends on.

        Args:
            numbers: number of each variable; None for its index, from 1.
        """
        index = numbers or {variable.name: number for number, variable in enumerate(self.variables, 1)}

        def part(dependencies: Mapping[str, Iterable[str]]) -> dict[int, list[int]]:
            return {index[name]: sorted(index[each] for each in on) for name, on in dependencies.items()}

        return {
            "Outputs": part(self.outputs),
            "Derivatives": part({name: self.outputs[name] for name in self.derivatives}),
            "InitialUnknowns": part(dict.fromkeys(self.initial_unknowns, self.initial_knowns)),
        }


FIRST_INTEGER, TIME, FIRST_INDICATOR, FIRST_DERIVATIVES, CLOCK, STATES = (sort << 28 for sort in range(1, 7))
"""First value references of FMI 3.0, where they are unique: of Integers, the time, event indicators, the derivatives of inputs, the clock, and all states;
Reals begin at 0. See ``c-runtime/fmi3/fmi3_version.h``."""


@dataclass(frozen=True)
class UniqueInterface:
    """The variables of an FMU as FMI 3.0 has them, with unique value references.

    States are outputs: the local aliases, which Maestro needs in FMI 2.0, are left out. As <Alias> elements they would make fmpy 0.3.32
    reject the description, which expects aliases of outputs among the initial unknowns.

    Attributes:
        variables: in the order of FMI 2.0, then those that only FMI 3.0 has: the time, event indicators, for each input an array
            with its time derivatives of orders 1, 2, .., the clock of a block, and arrays of all states and of their derivatives.
        references: name → value reference, also of the aliases.
        indicators: value references of the event indicators.
    """

    variables: tuple[FmiVariable, ...]
    references: Mapping[str, int]
    indicators: tuple[int, ...]


def unique_interface(
    interface: Interface, n_indicators: int, max_input_order: int, *, has_clock: bool
) -> UniqueInterface:
    """The variables of ``interface`` with those that only FMI 3.0 has.

    Args:
        interface: the variables of FMI 2.0.
        n_indicators: number of event indicators.
        max_input_order: highest order of input derivatives.
        has_clock: whether inputs and outputs are those of a clock's ticks.

    Raises:
        ModelError: a variable has the name of one of the further ones.
    """

    def real(
        name: str, reference: int, text: str, causality: str = "local", initial: str | None = "calculated", **more: Any
    ) -> FmiVariable:
        return FmiVariable(name, reference, "Real", text, causality, "continuous", initial, **more)

    time = real("time", TIME, "Time", "independent", None)
    indicators = [
        real(f"event_indicator[{k + 1}]", FIRST_INDICATOR + k, "Event indicator") for k in range(n_indicators)
    ]
    text = f"orders 1 to {max_input_order}, in SI units; zero after it is set"
    derivatives = [
        real(
            prefixed("derivatives", each.name),
            FIRST_DERIVATIVES + each.value_reference,
            *(f"Time derivatives of {each.name}, {text}", "input", None),
            start=0.0,
            size=max_input_order,
        )
        for each in interface.variables
        if each.causality == "input" and max_input_order
    ]
    clock = FmiVariable("clock", CLOCK, "Clock", "Ticks at the sample instants", "input", "discrete")
    count = len(interface.derivatives)
    both = {"states": "All continuous states", "der(states)": "Their time derivatives"} if count else {}
    states = [
        real(name, STATES + k, f"{what}, in the order of the model structure", size=count)
        for k, (name, what) in enumerate(both.items())
    ]
    more = (time, *indicators, *derivatives, *[clock] * has_clock, *states)
    further = replace(interface, variables=(*interface.variables, *more))
    numbered = [
        replace(each, value_reference=each.value_reference + FIRST_INTEGER) if each.kind == "Integer" else each
        for each in further.variables
    ]
    shown = {each.value_reference for each in numbered if each.causality != "local"}
    return UniqueInterface(
        variables=tuple(each for each in numbered if each.causality != "local" or each.value_reference not in shown),
        references={each.name: each.value_reference for each in numbered},
        indicators=tuple(each.value_reference for each in indicators),
    )


def build_interface(model: SymbolicModel) -> Interface:
    """The variables of ``model`` with their dependencies.

    Raises:
        ModelError: a name is repeated or unknown, a start value is missing or out of range, or a state isn't an output.
    """
    # an output that equals a state has its nominal value
    states = find_states(model)
    nominals = dict(zip(states.outputs, states.nominals, strict=True))
    shown = [
        variable if variable.nominal is not None else replace(variable, nominal=nominals.get(position))
        for position, variable in enumerate(model.outputs)
    ]
    reals = real_variables((*model.inputs, *model.parameters, *shown))
    settable, outputs = reals[: len(reals) - len(shown)], reals[len(reals) - len(shown) :]
    # the states are aliases of outputs, and other outputs are their derivatives
    aliases = tuple(
        replace(
            outputs[position],
            name=state_name(outputs[position].name),
            description=f"{outputs[position].description}, as a continuous state",
            causality="local",
        )
        for position in states.outputs
    )
    state_of = {position: alias.name for position, alias in zip(states.derivatives, aliases, strict=True)}
    outputs = tuple(replace(each, derivative=state_of.get(position)) for position, each in enumerate(outputs))
    # the initial state of a model that has a choice, counters, and the integrator, which initialisation doesn't need
    static = "static" if model.static_start else "undeformed"
    initial = () if model.nominals else (choice_variable(INITIAL, static, 0),)
    counters = [counter_variable(name, text, number) for number, (name, text) in enumerate(STATISTICS.items(), 1)]
    method = choice_variable(INTEGRATOR, "automatic", INTEGRATOR_REFERENCE)
    text = "Fixed step of the integrator; 0 = the step follows from the tolerance"
    step = real_variable(Variable(FIXED_STEP, "s", text, "parameter", start=0.0, minimum=0.0), len(reals))
    # outputs depend on inputs and states, initial unknowns on all that can be set before
    direct, needed = feedthrough(model.outputs, model.inputs, model.feedthrough), state_dependencies(model)
    return Interface(
        variables=(*settable, *aliases, *outputs, *initial, *counters, method, step),
        outputs={
            each.name: (*direct[each.name], *(aliases[k].name for k in states_needed))
            for each, states_needed in zip(outputs, needed, strict=True)
        },
        initial_unknowns=tuple(each.name for each in (*aliases, *outputs)),
        initial_knowns=tuple(each.name for each in (*settable, *initial)),
        derivatives=tuple(outputs[position].name for position in states.derivatives),
    )


def feedthrough(
    outputs: Iterable[Variable], inputs: Iterable[Variable], declared: Mapping[str, Sequence[str]]
) -> dict[str, tuple[str, ...]]:
    """Output → inputs that it depends on directly.

    Raises:
        ModelError: an output is missing in ``declared``, or has the name of something else than an input.
    """
    known = {variable.name for variable in inputs}
    found = {output.name: tuple(declared.get(output.name, ("(missing)",))) for output in outputs}
    for output, names in found.items():
        if unknown := set(names) - known:
            raise ModelError(f"feedthrough of output '{output}' names '{min(unknown)}', which is no input")
    return found


def real_variables(variables: Sequence[Variable], output_variability: str = "continuous") -> tuple[FmiVariable, ...]:
    """The entries of all real variables of a model, whose value references are their positions.

    Args:
        variables: the variables.
        output_variability: variability of outputs.

    Raises:
        ModelError: a start value is missing or out of range, or a variable is the derivative of an unknown one.
    """
    names = {variable.name for variable in variables} | {None}
    for variable in variables:
        if variable.derivative_of not in names:
            raise ModelError(
                f"variable '{variable.name}' is the derivative of '{variable.derivative_of}', which is not there"
            )
    return tuple(real_variable(variable, k, output_variability) for k, variable in enumerate(variables))


def real_variable(variable: Variable, value_reference: int, output_variability: str = "continuous") -> FmiVariable:
    """The entry of a real variable; arguments and errors as for `real_variables`."""
    is_output = variable.causality == "output"
    if not is_output:
        _check_start(variable)
    # outputs are calculated, inputs and parameters have start values
    variability = output_variability if is_output else "continuous"
    if variable.causality == "parameter":
        variability = "tunable" if variable.tunable else "fixed"
    return FmiVariable(
        name=variable.name,
        value_reference=value_reference,
        kind="Real",
        description=variable.description,
        causality=variable.causality,
        variability=variability,
        initial={"input": None, "parameter": "exact", "output": "calculated"}[variable.causality],
        start=None if is_output else variable.start,
        declared_type=quantity(variable.unit),
        unit=None if variable.unit == DIMENSIONLESS else variable.unit,
        display_unit=display_unit(variable.unit),
        minimum=variable.minimum,
        maximum=variable.maximum,
        nominal=variable.nominal,
    )


def _check_start(variable: Variable) -> None:
    start, low, high = variable.start, variable.minimum, variable.maximum
    if start is None:
        raise ModelError(f"{variable.causality} '{variable.name}' needs a start value")
    if (low is not None and start < low) or (high is not None and start > high):
        limits = f"{'-inf' if low is None else low} to {'inf' if high is None else high}"
        unit = "" if variable.unit == DIMENSIONLESS else f" {variable.unit}"
        raise StartError(f"start of '{variable.name}' must be within {limits}{unit}, got {start}{unit}")


def choice_variable(
    choice: ChoiceParameter, start: str, value_reference: int, variability: str = "fixed"
) -> FmiVariable:
    """The entry of a parameter with named values; ``start`` is the name of its start value."""
    return FmiVariable(
        name=choice.name,
        value_reference=value_reference,
        kind="Integer",
        description=choice.text,
        causality="parameter",
        variability=variability,
        initial="exact",
        start=choice.items[start][0],
        minimum=1,
        maximum=len(choice.items),
    )


def counter_variable(name: str, description: str, value_reference: int) -> FmiVariable:
    """The entry of a counter."""
    return FmiVariable(name, value_reference, "Integer", description, "local", "discrete", "calculated")


USUAL_MOTION = 10.0
"""Usual size of a motion in the error norm, relative to the norm's floor; the five-bar's floor corresponds to an
acceleration of 1 m/s² or a motor rate of 0.1 rad/s."""

USUAL_ANGLE = 1.0
"""Usual size of a motor's coordinate [rad]; the error norm gives none, since the origin is arbitrary."""


@dataclass(frozen=True)
class States:
    """Outputs and nominal values of the states: coordinates, then rates (`SymbolicModel.states`).

    Attributes:
        outputs: index of the output that equals each state, from 0.
        derivatives: index of the output that equals each state's time derivative, in the same order.
        nominals: nominal value of each state in its unit, positive.
    """

    outputs: tuple[int, ...]
    derivatives: tuple[int, ...]
    nominals: tuple[float, ...]


def state_name(output: str) -> str:
    """Name of the state that equals an output: ``state.joint1.position``, ``der(state.link11.bending[1])``."""
    return prefixed("state", output)


def prefixed(prefix: str, name: str) -> str:
    """The structured name with another component in front, which is within ``der(..)``."""
    head, inner = ("der(", name.removeprefix("der(")) if name.startswith("der(") else ("", name)
    return f"{head}{prefix}.{inner}"


def find_states(model: SymbolicModel) -> States:
    """Find the states of ``model`` among its outputs, by the names of the unknowns and by ``derivative_of``.

    Raises:
        ModelError: a state or its derivative is not an output.
    """
    position: dict[str | None, int] = {variable.name: index for index, variable in enumerate(model.outputs)}
    derivative = {variable.derivative_of: variable.name for variable in model.outputs}
    # coordinates, velocities, accelerations; the name of an unknown of first order is that of its rate
    rates = model.degrees_of_freedom - model.has_clock
    names = list(model.unknowns[: rates - model.first_order])
    velocities = [_shown(derivative, name, "time derivative of") for name in names]
    velocities += model.unknowns[len(names) : rates]
    accelerations = [_shown(derivative, name, "time derivative of") for name in velocities]
    y, v, a = ([_shown(position, name, "state") for name in each] for each in (names, velocities, accelerations))
    return States((*y, *v), (*v[: len(y)], *a), model.nominals or _nominals(model))


def state_dependencies(model: SymbolicModel) -> tuple[tuple[int, ...], ...]:
    """For each output the numbers of the states that it depends on; all if it depends on accelerations."""
    outputs, n = model.functions["outputs"], model.degrees_of_freedom
    y, v, a = (_rows(outputs.jac_sparsity(0, argument)) if n else {} for argument in range(3))
    number = {place: k for k, place in enumerate(model.states)}
    return tuple(
        tuple(number.values())
        if row in a
        else tuple(
            number[k] for k in (*sorted(y.get(row, ())), *(n + k for k in sorted(v.get(row, ())))) if k in number
        )
        for row in range(len(model.outputs))
    )


def _rows(sparsity: casadi.Sparsity) -> dict[int, set[int]]:
    """Row → columns of its structural nonzeros; empty rows are left out."""
    rows: dict[int, set[int]] = {}
    for row, column in zip(*sparsity.get_triplet(), strict=True):
        rows.setdefault(row, set()).add(column)
    return rows


def _shown(table: Mapping[str | None, T], name: str, what: str) -> T:
    if name not in table:
        raise ModelError(f"no output shows the {what} '{name}', which model exchange needs")
    return table[name]


def _nominals(model: SymbolicModel) -> tuple[float, ...]:
    """Nominal values of the states, two digits, from the error norm sqrt(sum kappa_i dy_i² + mu_i dv_i²)."""
    n = model.degrees_of_freedom
    # weights of the error norm at the start values
    derived = model.functions["derive"]([variable.start or 0.0 for variable in model.parameters])
    *weights, floor = model.functions["error_scale"](derived).full().ravel().tolist()
    sizes = [USUAL_MOTION * floor / sqrt(weight) if weight > 0.0 else 1.0 for weight in weights]
    sizes[: model.locked] = [USUAL_ANGLE] * model.locked
    return tuple(float(f"{size:.2g}") if isfinite(size) and size > 0.0 else 1.0 for size in sizes[: 2 * n])
