"""modelDescription.xml against the rules of FMI 2.0."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from fmpy.model_description import read_model_description

from flexfmu.fmu_build.choices import INITIAL, INTEGRATOR
from flexfmu.fmu_build.description import description_xml
from flexfmu.fmu_build.errors import BuildError, ModelError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.interface import STATISTICS, build_interface
from flexfmu.fmu_build.sources import plant_description
from flexfmu.model.symbolic import SymbolicModel

MakeModel = Callable[..., SymbolicModel]


@pytest.fixture
def read(tmp_path: Path) -> Callable[[SymbolicModel], Any]:
    """Write the description of a model and read it back with all of fmpy's checks."""

    def write_and_read(model: SymbolicModel) -> Any:
        text = description_xml(
            plant_description(model), "{guid}", DefaultExperiment(0.68, 2e-4, 1e-7), ("one.c", "two.c")
        )
        (tmp_path / "modelDescription.xml").write_text(text, encoding="utf-8")
        return read_model_description(
            str(tmp_path), validate=True, validate_variable_names=True, validate_model_structure=True
        )

    return write_and_read


@pytest.mark.parametrize("model", ["make_oscillators", "make_lever"])
def test_description_passes_schema_and_rules(model: str, read: Any, request: pytest.FixtureRequest) -> None:
    """Schema, names, legal combinations, units and model structure, as fmpy checks them."""
    make: MakeModel = request.getfixturevalue(model)
    assert read(make()).guid == "{guid}"


def test_capabilities_are_what_the_runtime_does(make_oscillators: MakeModel, read: Any) -> None:
    """A master relies on these flags before it calls."""
    slave = read(make_oscillators()).coSimulation
    assert slave.modelIdentifier == "oscillators"
    assert slave.canHandleVariableCommunicationStepSize
    assert slave.canInterpolateInputs
    assert slave.maxOutputDerivativeOrder == 2
    assert slave.canGetAndSetFMUstate
    assert slave.canSerializeFMUstate
    assert not slave.canBeInstantiatedOnlyOncePerProcess


def test_default_experiment_is_the_one_asked_for(make_oscillators: MakeModel, read: Any) -> None:
    """Without arguments a tool runs the scene's motion with the scene's step and tolerance."""
    experiment = read(make_oscillators()).defaultExperiment
    values = experiment.startTime, experiment.stopTime, experiment.stepSize, experiment.tolerance
    assert [float(value) for value in values] == [0.0, 0.68, 2e-4, 1e-7]


def test_value_references_count_inputs_parameters_outputs(make_oscillators: MakeModel, read: Any) -> None:
    """The runtime indexes its arrays by value reference, in this order."""
    model = make_oscillators()
    variables = read(model).modelVariables
    reals = [variable for variable in variables if variable.type == "Real"]
    names = [variable.name for variable in (*model.inputs, *model.parameters, *model.outputs)]
    own = [variable for variable in reals if variable.causality != "local"]
    assert [variable.name for variable in own] == [*names, "integrator.step"]
    assert [variable.valueReference for variable in own] == list(range(len(names) + 1))
    others = [(v.name, v.type, v.valueReference) for v in variables if v.type != "Real"]
    counters = [(name, "Integer", count) for count, name in enumerate(STATISTICS, start=1)]
    assert others == [("initial", "Integer", 0), *counters, ("integrator", "Integer", len(counters) + 1)]


def test_tunable_parameters_say_so(make_oscillators: MakeModel, read: Any) -> None:
    """A tool may change tunable parameters only while the simulation runs."""
    variability = {variable.name: variable.variability for variable in read(make_oscillators()).modelVariables}
    assert variability["damping.time"] == "tunable"
    assert variability["mass"] == "fixed"


@pytest.mark.parametrize(("static", "start"), [(True, "1"), (False, "2")])
def test_initial_state_starts_as_the_model_says(
    make_oscillators: MakeModel, read: Any, static: bool, start: str
) -> None:
    """`initial` has the scene's choice as its start."""
    variable = next(v for v in read(make_oscillators(static_start=static)).modelVariables if v.name == "initial")
    assert variable.start == start


def test_choices_are_numbers_that_their_descriptions_explain(make_oscillators: MakeModel, read: Any) -> None:
    """Some importers take no enumerations: a user there sees in the description which number means what."""
    variables = {variable.name: variable for variable in read(make_oscillators()).modelVariables}
    for choice in (INITIAL, INTEGRATOR):
        variable = variables[choice.name]
        assert (variable.type, variable.min, variable.max) == ("Integer", "1", str(len(choice.items)))
        assert [number for number, _ in choice.items.values()] == list(range(1, len(choice.items) + 1))
        assert all(
            f"{number} {name}: {meaning}" in variable.description for name, (number, meaning) in choice.items.items()
        )


def test_outputs_depend_on_states_and_on_what_feeds_through(make_oscillators: MakeModel, read: Any) -> None:
    """Masters sort slaves by these dependencies: a missing one is a wrong order, one too many a false algebraic loop."""
    depends = {u.variable.name: {v.name for v in u.dependencies} for u in read(make_oscillators()).outputs}
    first, second = "state.first.position", "state.second.position"
    assert depends["power"] == {f"der({first})", "force"}
    assert depends["first.spring_force"] == {first}
    assert depends["der(second.position,2)"] == {first, f"der({first})", second, f"der({second})"}
    assert depends["first.position"] == {first}


def test_derivatives_are_the_state_derivatives(make_oscillators: MakeModel, read: Any) -> None:
    """Velocities and accelerations of the coordinates, each tied to the state that it derives, in the runtime's order."""
    derivatives = [(u.variable.name, u.variable.derivative.name) for u in read(make_oscillators()).derivatives]
    assert derivatives == [
        ("der(first.position)", "state.first.position"),
        ("der(second.position)", "state.second.position"),
        ("der(first.position,2)", "der(state.first.position)"),
        ("der(second.position,2)", "der(state.second.position)"),
    ]


def test_states_are_aliases_of_outputs(make_oscillators: MakeModel, read: Any) -> None:
    """No output is declared a state, since importers stumble where it is connected beside its derivative."""
    variables = read(make_oscillators()).modelVariables
    by_name = {variable.name: variable for variable in variables}
    states = [variable for variable in variables if variable.name.removeprefix("der(").startswith("state.")]
    assert len(states) == 4
    for state in states:
        shown = by_name[state.name.replace("state.", "")]
        assert (state.causality, shown.causality) == ("local", "output")
        assert (state.valueReference, state.unit) == (shown.valueReference, shown.unit)
    assert all(each.derivative.causality == "local" for each in variables if each.derivative is not None)


def test_states_say_their_usual_size(make_oscillators: MakeModel, read: Any) -> None:
    """An importer's integrator measures absolute errors by it: ten times what the error norm takes for a small motion."""
    nominal = {variable.name: variable.nominal for variable in read(make_oscillators()).modelVariables}
    assert float(nominal["first.position"]) == pytest.approx(1e-5 / 800.0**0.5, rel=0.05)
    assert float(nominal["der(second.position)"]) == pytest.approx(1e-5 / 2.0**0.5, rel=0.05)
    assert nominal["der(first.position,2)"] is None


def test_hidden_states_are_refused(make_oscillators: MakeModel, read: Any) -> None:
    """An importer that integrates must find every state and its derivative among the variables."""
    model = make_oscillators()
    for position in range(3):
        fewer = model.outputs[:position] + model.outputs[position + 1 :]
        with pytest.raises(ModelError, match="no output shows"):
            read(replace(model, outputs=fewer))


def test_both_interfaces_share_one_binary(make_oscillators: MakeModel, read: Any) -> None:
    """Model exchange and co-simulation are the same equations in the same library, with the same capabilities."""
    description = read(make_oscillators())
    both = description.coSimulation, description.modelExchange
    assert len({each.modelIdentifier for each in both}) == 1
    for each in both:
        assert (each.providesDirectionalDerivative, each.canGetAndSetFMUstate, each.canSerializeFMUstate) == (True,) * 3
    assert (description.numberOfContinuousStates, description.numberOfEventIndicators) == (4, 0)


def test_initial_unknowns_depend_on_all_that_can_be_set(make_oscillators: MakeModel, read: Any) -> None:
    """The static equilibrium couples everything: inputs, parameters and the choice of the start."""
    model = make_oscillators()
    unknowns = read(model).initialUnknowns
    settable = {variable.name for variable in (*model.inputs, *model.parameters)} | {"initial"}
    names = {unknown.variable.name for unknown in unknowns}
    assert {name for name in names if "state." not in name} == {output.name for output in model.outputs}
    assert len(names) == len(model.outputs) + 2 * model.degrees_of_freedom
    assert all({v.name for v in unknown.dependencies} == settable for unknown in unknowns)


def test_starts_are_exact(make_oscillators: MakeModel, read: Any) -> None:
    """The decimal start in the description is the binary start in the FMU."""
    variables = {v.name: v for v in read(make_oscillators(mass=0.1 + 0.2)).modelVariables}
    assert float(variables["mass"].start) == 0.1 + 0.2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start": None}, "needs a start value"),
        ({"start": -1.0}, "must be within 0.5 to inf kg, got -1.0"),
        ({"name": "stiffness"}, "more than once"),
        ({"name": "initial"}, "more than once"),
        ({"unit": "stone"}, "stone"),
    ],
)
def test_contradictory_parameter_is_refused(
    make_oscillators: MakeModel, read: Any, change: dict[str, Any], message: str
) -> None:
    """A wrong model gives one sentence, not a file that importers refuse."""
    model = make_oscillators()
    mass = replace(model.parameters[0], **{"minimum": 0.5, **change})
    with pytest.raises(ModelError, match=message):
        read(replace(model, parameters=(mass, *model.parameters[1:])))


def test_feedthrough_must_name_inputs(make_oscillators: MakeModel) -> None:
    """Dependencies on something that isn't an input, or no entry at all, are a mistake of the model."""
    model = make_oscillators()
    for feedthrough in ({}, {**model.feedthrough, "power": ("mass",)}):
        with pytest.raises(ModelError, match="feedthrough"):
            build_interface(replace(model, feedthrough=feedthrough))


@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan")])
def test_impossible_default_experiment_is_refused(value: float) -> None:
    """NaN and negative times never get into a file."""
    with pytest.raises(BuildError, match="stop_time"):
        DefaultExperiment(stop_time=value)


def test_derivatives_come_after_their_states(make_oscillators: MakeModel) -> None:
    """OMSimulator 3.0 looks a state up among the variables before its derivative; the numbers are right all the same."""
    interface = build_interface(make_oscillators())
    index = {variable.name: number for number, variable in enumerate(interface.variables)}
    tied = [each for each in interface.variables if each.derivative is not None]
    assert tied
    assert all(index[each.derivative] < index[each.name] for each in tied if each.derivative is not None)
    assert {interface.variables[index[name]].causality for name in interface.outputs} == {"output"}
