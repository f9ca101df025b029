"""The variables of a model description: indices, value references, causality, variability and dependencies."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from flexfmu.fmu_build.choices import FIXED_STEP, INITIAL, INTEGRATOR, INTEGRATOR_REFERENCE, ChoiceParameter
from flexfmu.fmu_build.errors import ModelError, StartError
from flexfmu.fmu_build.states import States, find_states, state_dependencies, state_name
from flexfmu.fmu_build.units import DIMENSIONLESS, display_unit, quantity

if TYPE_CHECKING:
    from flexfmu.model.symbolic import SymbolicModel, Variable

STATISTICS: Mapping[str, str] = {
    "statistics.steps": "Accepted steps of the integrator since initialisation",
    "statistics.rejections": "Rejected steps of the integrator since initialisation",
    "statistics.evaluations": "Evaluations of the equations of motion since initialisation",
    "statistics.iterations": "Iterations for the stage equations since initialisation",
    "statistics.factorisations": "Factorisations of the iteration matrix since initialisation",
}
"""Counters of the integrator, in the order of their value references."""

VariableType = Literal["Real", "Integer"]


@dataclass(frozen=True)
class FmiVariable:
    """A scalar variable of the model description; attributes are spelt as in the FMI 2.0 standard.

    Attributes:
        index: position among the model variables, from 1.
        value_reference: value reference, from 0 for each type.
        kind: FMI type.
        start: start value; None where the standard forbids one.
        declared_type: name of the type, which is the physical quantity.
        unit, display_unit: None for dimensionless variables.
        derivative: index of the continuous state of which this variable is the time derivative.
    """

    index: int
    value_reference: int
    kind: VariableType
    name: str
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
    derivative: int | None = None


@dataclass(frozen=True)
class Unknown:
    """An entry of the model structure: index of the variable, and indices of the variables that it depends on."""

    index: int
    dependencies: tuple[int, ...]


@dataclass(frozen=True)
class Interface:
    """All variables of an FMU and the model structure.

    Attributes:
        variables: in the order of the model description: inputs, parameters, states, outputs, variables of other types.
            Each derivative follows its state, otherwise OMSimulator 3.0 fails.
        outputs: all outputs, with the inputs and states that they depend on.
        derivatives: the state derivatives among the outputs, in the order of the states.
        initial_unknowns: outputs and states, with the inputs and parameters that they depend on at initialisation.
    """

    variables: tuple[FmiVariable, ...]
    outputs: tuple[Unknown, ...]
    derivatives: tuple[Unknown, ...]
    initial_unknowns: tuple[Unknown, ...]


def build_interface(model: SymbolicModel) -> Interface:
    """Number the variables of ``model`` and determine their dependencies.

    Raises:
        ModelError: a name is repeated or unknown, or a start value is missing or out of range.
    """
    # an output that equals a state has its nominal value
    states = find_states(model)
    nominals = dict(zip(states.outputs, states.nominals, strict=True))
    outputs = [
        variable if variable.nominal is not None else replace(variable, nominal=nominals.get(position))
        for position, variable in enumerate(model.outputs)
    ]
    # names are unique over variables of all kinds
    scalars = (*model.inputs, *model.parameters, *outputs)
    names = [variable.name for variable in scalars]
    shown = [state_name(model.outputs[position].name) for position in states.outputs]
    check_names([*names, INITIAL.name, *STATISTICS, INTEGRATOR.name, FIXED_STEP, *shown])
    index_of = {variable.name: index for index, variable in enumerate(scalars, start=1)}
    # number the variables, one kind after the other
    reals = tuple(real_variable(variable, index_of) for variable in scalars)
    integers = _integer_variables(first_index=len(reals) + 1, static_start=model.static_start)
    integrator = _integrator_variables(first_index=len(reals) + len(integers) + 1, value_reference=len(reals))
    first, first_state = len(model.inputs) + len(model.parameters) + 1, len(reals) + len(integers) + len(integrator) + 1
    aliases = _state_variables(reals[first - 1 :], states, first_state)

    # outputs and derivatives depend on inputs and states
    direct, needed = feedthrough(model.outputs, model.inputs, model.feedthrough, index_of), state_dependencies(model)
    unknowns = tuple(
        Unknown(first + k, (*direct[first + k], *sorted(first_state + state for state in needed[k])))
        for k in range(len(model.outputs))
    )
    # initial unknowns depend on all inputs and parameters
    known = tuple(variable.index for variable in reals + integers if variable.causality in ("input", "parameter"))
    variables = _with_derivatives(reals, states, first, first_state)
    interface = Interface(
        variables=variables + integers + integrator + aliases,
        outputs=unknowns,
        derivatives=tuple(unknowns[position] for position in states.derivatives),
        initial_unknowns=tuple(Unknown(each.index, known) for each in (*aliases, *reals[first - 1 :])),
    )
    # derivatives must follow their states, otherwise OMSimulator 3.0 fails
    return _reordered(interface, (*variables[: first - 1], *aliases, *variables[first - 1 :], *integers, *integrator))


def _reordered(interface: Interface, variables: Sequence[FmiVariable]) -> Interface:
    """The interface with its variables in another order; all indices are renumbered."""
    new = {variable.index: index for index, variable in enumerate(variables, start=1)}

    def unknowns(each: Sequence[Unknown]) -> tuple[Unknown, ...]:
        return tuple(Unknown(new[u.index], tuple(sorted(new[i] for i in u.dependencies))) for u in each)

    # derivatives and dependencies are indices too
    return Interface(
        variables=tuple(
            replace(v, index=new[v.index], derivative=None if v.derivative is None else new[v.derivative])
            for v in variables
        ),
        outputs=unknowns(interface.outputs),
        derivatives=unknowns(interface.derivatives),
        initial_unknowns=unknowns(interface.initial_unknowns),
    )


def _state_variables(outputs: Sequence[FmiVariable], states: States, first_index: int) -> tuple[FmiVariable, ...]:
    """The states, as aliases of outputs."""
    return tuple(
        replace(
            outputs[position],
            index=index,
            name=state_name(outputs[position].name),
            description=f"{outputs[position].description}, as a continuous state",
            causality="local",
        )
        for index, position in enumerate(states.outputs, start=first_index)
    )


def _with_derivatives(
    reals: Sequence[FmiVariable], states: States, first_output: int, first_state: int
) -> tuple[FmiVariable, ...]:
    """The real variables, with ``derivative`` set for state derivatives; indices count from 1."""
    state_of = {first_output + position: first_state + k for k, position in enumerate(states.derivatives)}
    return tuple(replace(variable, derivative=state_of.get(variable.index)) for variable in reals)


def feedthrough(
    outputs: Iterable[Variable],
    inputs: Iterable[Variable],
    declared: Mapping[str, Sequence[str]],
    index_of: Mapping[str, int],
) -> dict[int, tuple[int, ...]]:
    """Index of each output → indices of the inputs that it depends on directly.

    Raises:
        ModelError: an output is missing in ``declared``, or has the name of something else than an input.
    """
    known = {variable.name for variable in inputs}
    found = {}
    for output in outputs:
        names = declared.get(output.name, ("(missing)",))
        if unknown := set(names) - known:
            raise ModelError(f"feedthrough of output '{output.name}' names '{min(unknown)}', which is no input")
        found[index_of[output.name]] = tuple(sorted(index_of[name] for name in names))
    return found


def check_names(names: Iterable[str]) -> None:
    """Check that names are unique.

    Raises:
        ModelError: a name is repeated.
    """
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ModelError(f"variable '{twice[0]}' is there more than once; names must be unique")


def real_variable(
    variable: Variable, index_of: Mapping[str, int], output_variability: str = "continuous"
) -> FmiVariable:
    """The entry of a real variable; its value reference is index - 1.

    Args:
        variable: the variable.
        index_of: name → index of all real variables.
        output_variability: variability of outputs.

    Raises:
        ModelError: a start value is missing or out of range, or the variable is the derivative of an unknown one.
    """
    is_output = variable.causality == "output"
    if not is_output:
        _check_start(variable)
    if variable.derivative_of is not None and variable.derivative_of not in index_of:
        raise ModelError(
            f"variable '{variable.name}' is the derivative of '{variable.derivative_of}', which is not there"
        )
    # outputs are calculated, inputs and parameters have start values
    index = index_of[variable.name]
    variability = output_variability if is_output else "continuous"
    if variable.causality == "parameter":
        variability = "tunable" if variable.tunable else "fixed"
    return FmiVariable(
        index=index,
        value_reference=index - 1,
        kind="Real",
        name=variable.name,
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
    choice: ChoiceParameter, start: str, index: int, value_reference: int, variability: str = "fixed"
) -> FmiVariable:
    """The entry of a parameter with named values.

    Args:
        choice: the parameter.
        start: name of its start value.
        index, value_reference, variability: as in `FmiVariable`.
    """
    low, high = choice.limits
    return FmiVariable(
        index=index,
        value_reference=value_reference,
        kind="Integer",
        name=choice.name,
        description=choice.text,
        causality="parameter",
        variability=variability,
        initial="exact",
        start=choice.items[start][0],
        minimum=low,
        maximum=high,
    )


def counter_variable(name: str, description: str, index: int, value_reference: int) -> FmiVariable:
    """The entry of a counter; index and value reference as in `FmiVariable`."""
    return FmiVariable(
        index=index,
        value_reference=value_reference,
        kind="Integer",
        name=name,
        description=description,
        causality="local",
        variability="discrete",
        initial="calculated",
    )


def _integer_variables(first_index: int, static_start: bool) -> tuple[FmiVariable, ...]:
    """The parameter ``initial`` and the integrator's counters, with value references from 0."""
    initial = choice_variable(INITIAL, "static" if static_start else "undeformed", first_index, value_reference=0)
    # counters have value references from 1
    counters = tuple(
        counter_variable(name, description, first_index + count, count)
        for count, (name, description) in enumerate(STATISTICS.items(), start=1)
    )
    return (initial, *counters)


def _integrator_variables(first_index: int, value_reference: int) -> tuple[FmiVariable, ...]:
    """The parameters for the integration method and for a fixed step, the last Real; initialisation needs neither."""
    method = choice_variable(INTEGRATOR, "automatic", first_index, INTEGRATOR_REFERENCE)
    # zero selects the variable step
    step = FmiVariable(
        index=first_index + 1,
        value_reference=value_reference,
        kind="Real",
        name=FIXED_STEP,
        description="Fixed step of the integrator; 0 = the step follows from the tolerance",
        causality="parameter",
        variability="fixed",
        initial="exact",
        start=0.0,
        declared_type=quantity("s"),
        unit="s",
        display_unit=display_unit("s"),
        minimum=0.0,
    )
    return method, step
