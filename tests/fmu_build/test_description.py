"""modelDescription.xml against the rules of FMI 2.0."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from fmpy.model_description import read_model_description

from flexfmu.fmu_build.choices import INITIAL, INTEGRATOR
from flexfmu.fmu_build.description import description_xml
from flexfmu.fmu_build.errors import BuildError, ModelError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.interface import STATISTICS, build_interface
from flexfmu.fmu_build.source_generation import plant_description
from flexfmu.model.symbolic import SymbolicModel

MakeModel = Callable[..., SymbolicModel]


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Callable[[SymbolicModel], Any]:
    """Write the description of a model and read it back with all of fmpy's checks: schema, names, units, model structure."""
    folder = tmp_path_factory.mktemp("description")

    def write_and_read(model: SymbolicModel) -> Any:
        experiment = DefaultExperiment(0.68, 2e-4, 1e-7)
        text = description_xml(plant_description(model), "{guid}", experiment, ("one.c", "two.c"))
        (folder / "modelDescription.xml").write_text(text, encoding="utf-8")
        return read_model_description(
            str(folder), validate=True, validate_variable_names=True, validate_model_structure=True
        )

    return write_and_read


@pytest.fixture(scope="module")
def model(make_oscillators: MakeModel) -> SymbolicModel:
    """The oscillators, whose mass has a start without an exact decimal."""
    return make_oscillators(mass=0.1 + 0.2)


@pytest.fixture(scope="module")
def description(model: SymbolicModel, read: Any) -> Any:
    """Their description, read back."""
    return read(model)


@pytest.fixture(scope="module")
def variables(description: Any) -> dict[str, Any]:
    """Its variables by name."""
    return {variable.name: variable for variable in description.modelVariables}


def test_a_rigid_model_passes_schema_and_rules(make_lever: MakeModel, read: Any) -> None:
    """Without unknowns there are neither states nor derivatives to list."""
    assert read(make_lever()).guid == "{guid}"


def test_head_is_what_the_runtime_does(description: Any) -> None:
    """Masters rely on these flags before they call; both interfaces are the same equations in one library; without arguments a tool
    runs the scene's motion with the scene's step and tolerance."""
    slave, exchange, experiment = description.coSimulation, description.modelExchange, description.defaultExperiment
    assert (slave.canHandleVariableCommunicationStepSize, slave.canInterpolateInputs) == (True, True)
    assert slave.maxOutputDerivativeOrder == 2
    for each in (slave, exchange):
        assert each.modelIdentifier == "oscillators"
        assert (each.providesDirectionalDerivative, each.canGetAndSetFMUstate, each.canSerializeFMUstate) == (True,) * 3
        assert not each.canBeInstantiatedOnlyOncePerProcess
    assert (description.numberOfContinuousStates, description.numberOfEventIndicators) == (4, 0)
    values = experiment.startTime, experiment.stopTime, experiment.stepSize, experiment.tolerance
    assert [float(value) for value in values] == [0.0, 0.68, 2e-4, 1e-7]


def test_value_references_count_inputs_parameters_outputs(model: SymbolicModel, variables: dict[str, Any]) -> None:
    """The runtime indexes its arrays by value reference, in this order."""
    names = [variable.name for variable in (*model.inputs, *model.parameters, *model.outputs)]
    own = [each for each in variables.values() if each.type == "Real" and each.causality != "local"]
    assert [(each.name, each.valueReference) for each in own] == list(
        zip([*names, "integrator.step"], range(len(names) + 1), strict=True)
    )
    others = [(v.name, v.type, v.valueReference) for v in variables.values() if v.type != "Real"]
    assert others == [(name, "Integer", i) for i, name in enumerate(("initial", *STATISTICS, "integrator"))]


def test_parameters_are_the_models(make_oscillators: MakeModel, variables: dict[str, Any], read: Any) -> None:
    """A tool may change the tunable ones while the simulation runs; the decimal start is the binary start in the FMU; `initial` has
    the scene's choice as its start."""
    assert (variables["damping.time"].variability, variables["mass"].variability) == ("tunable", "fixed")
    assert float(variables["mass"].start) == 0.1 + 0.2
    assert variables["initial"].start == "1"
    others = read(make_oscillators(static_start=False)).modelVariables
    assert next(v for v in others if v.name == "initial").start == "2"


def test_choices_are_numbers_that_their_descriptions_explain(variables: dict[str, Any]) -> None:
    """Some importers take no enumerations: a user there sees in the description which number means what."""
    for choice in (INITIAL, INTEGRATOR):
        variable = variables[choice.name]
        assert (variable.type, variable.min, variable.max) == ("Integer", "1", str(len(choice.items)))
        assert [number for number, _ in choice.items.values()] == list(range(1, len(choice.items) + 1))
        assert all(f"{i} {name}: {meaning}" in variable.description for name, (i, meaning) in choice.items.items())


def test_outputs_depend_on_states_and_on_what_feeds_through(description: Any) -> None:
    """Masters sort slaves by these dependencies: a missing one is a wrong order, one too many a false algebraic loop."""
    depends = {u.variable.name: {v.name for v in u.dependencies} for u in description.outputs}
    first, second = "state.first.position", "state.second.position"
    assert depends["power"] == {f"der({first})", "force"}
    assert depends["first.spring_force"] == depends["first.position"] == {first}
    assert depends["der(second.position,2)"] == {first, f"der({first})", second, f"der({second})"}


def test_states_are_aliases_of_outputs(description: Any, variables: dict[str, Any]) -> None:
    """No output is declared a state, since importers stumble where it is connected beside its derivative. Each derivative is tied to
    the state that it derives, in the runtime's order. An importer's integrator measures absolute errors by the nominal values: ten
    times what the error norm takes for a small motion."""
    assert [(u.variable.name, u.variable.derivative.name) for u in description.derivatives] == [
        ("der(first.position)", "state.first.position"),
        ("der(second.position)", "state.second.position"),
        ("der(first.position,2)", "der(state.first.position)"),
        ("der(second.position,2)", "der(state.second.position)"),
    ]
    for derivative in description.derivatives:
        state = derivative.variable.derivative
        shown = variables[state.name.replace("state.", "")]
        assert (state.causality, shown.causality) == ("local", "output")
        assert (state.valueReference, state.unit) == (shown.valueReference, shown.unit)
    assert float(variables["first.position"].nominal) == pytest.approx(1e-5 / 800.0**0.5, rel=0.05)
    assert float(variables["der(second.position)"].nominal) == pytest.approx(1e-5 / 0.3**0.5, rel=0.05)
    assert variables["der(first.position,2)"].nominal is None


def test_derivatives_come_after_their_states(model: SymbolicModel) -> None:
    """OMSimulator 3.0 looks a state up among the variables before its derivative; the numbers are right all the same."""
    interface = build_interface(model)
    index = {variable.name: number for number, variable in enumerate(interface.variables)}
    tied = [(each.derivative, each.name) for each in interface.variables if each.derivative is not None]
    assert tied
    assert all(index[state] < index[name] for state, name in tied)
    assert {interface.variables[index[name]].causality for name in interface.outputs} == {"output"}


def test_initial_unknowns_depend_on_all_that_can_be_set(model: SymbolicModel, description: Any) -> None:
    """The static equilibrium couples everything: inputs, parameters and the choice of the start."""
    settable = {variable.name for variable in (*model.inputs, *model.parameters)} | {"initial"}
    names = {unknown.variable.name for unknown in description.initialUnknowns}
    assert {name for name in names if "state." not in name} == {output.name for output in model.outputs}
    assert len(names) == len(model.outputs) + 2 * model.degrees_of_freedom
    assert all({v.name for v in unknown.dependencies} == settable for unknown in description.initialUnknowns)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start": None}, "needs a start value"),
        ({"start": -1.0}, "must be within 0.25 to inf kg, got -1.0"),
        ({"name": "stiffness"}, "more than once"),
        ({"name": "initial"}, "more than once"),
        ({"unit": "stone"}, "stone"),
        ({"name": "Mass"}, "variable 'Mass' has the name of a type"),
    ],
)
def test_contradictory_parameter_is_refused(
    model: SymbolicModel, read: Any, change: dict[str, Any], message: str
) -> None:
    """A wrong model gives one sentence, not a file that importers refuse."""
    mass = replace(model.parameters[0], **{"minimum": 0.25, **change})
    with pytest.raises(ModelError, match=message):
        read(replace(model, parameters=(mass, *model.parameters[1:])))


def test_incomplete_models_are_refused(model: SymbolicModel) -> None:
    """An importer that integrates must find every state and its derivative; dependencies name inputs, for every output."""
    for position in range(3):
        fewer = model.outputs[:position] + model.outputs[position + 1 :]
        with pytest.raises(ModelError, match="no output shows"):
            plant_description(replace(model, outputs=fewer))
    for feedthrough in ({}, {**model.feedthrough, "power": ("mass",)}):
        with pytest.raises(ModelError, match="feedthrough"):
            build_interface(replace(model, feedthrough=feedthrough))


@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan")])
def test_impossible_default_experiment_is_refused(value: float) -> None:
    """NaN and negative times never get into a file."""
    with pytest.raises(BuildError, match="stop_time"):
        DefaultExperiment(stop_time=value)
