"""The files: valid for others' tools, reproducible, found again, and fast with thousands of states."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi
import fmpy
import numpy as np
import pytest
from export_support.blocks import SAMPLE_TIME, block, delay, expected, fir, gain, pd_controller, quantiser, saturation
from export_support.instance import run
from export_support.trajectories import Swing, lame
from fmpy.validation import validate_fmu as validate_by_fmpy

from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.sources import generate_sources
from flexfmu.fmu_build.trajectory_build import Motion
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType
from flexfmu.fmu_build.validation.steps import interpolates_inputs
from flexfmu.fmu_build.validation.validate import validate_fmu
from flexfmu.model.symbolic import SymbolicBlock, Variable
from flexfmu.trajectories.profiles import bang_bang

Export = Callable[..., Any]

BLOCKS = [pd_controller, fir, delay, quantiser, saturation]


@pytest.mark.parametrize("make", BLOCKS, ids=lambda make: make.__name__)
def test_block_is_valid(make: Callable[[], SymbolicBlock], tmp_path: Path) -> None:
    """Other tools check more than ours: description by fmpy, symbols, and a short life in a process of its own."""
    built = build_fmu(make(), tmp_path / "block.fmu", stop_time=0.05)
    assert validate_by_fmpy(str(built.path)) == []
    assert validate_fmu(built.path) == []


def test_ignored_input_derivatives_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A block that claims to follow a ramp between communication points is tried with several samples between them."""
    path = build_fmu(fir(), stop_time=0.05).path
    fmpy.extract(str(path), tmp_path)
    fmu = FmuUnderTest(fmpy.read_model_description(str(path)), tmp_path, InterfaceType.COSIMULATION)
    assert list(interpolates_inputs(fmu)) == []
    monkeypatch.setattr(fmpy.fmi2.FMU2Slave, "setRealInputDerivatives", lambda *_: None)
    (finding,) = interpolates_inputs(fmu)
    assert "with a derivative of in1 out1 is 0.00775 off" in finding.message


@pytest.mark.slow
def test_trajectory_is_valid(tmp_path: Path) -> None:
    """The same for trajectories."""
    built = build_fmu(Motion(lame(bang_bang())), tmp_path / "trajectory.fmu")
    assert validate_by_fmpy(str(built.path)) == []
    assert validate_fmu(built.path) == []


def test_fmpy_simulates_a_block(tmp_path: Path) -> None:
    """Somebody else's master gets the samples as well: inputs are set, then the step is made, then the outputs are read,
    so that it records at each instant the sample with the input of the step before it."""
    built = build_fmu(quantiser(), tmp_path / "block.fmu")
    times = SAMPLE_TIME * np.arange(51)
    signal = np.array(list(zip(times, np.sin(60.0 * times), strict=True)), dtype=[("time", "f8"), ("in1", "f8")])
    result = fmpy.simulate_fmu(
        str(built.path), stop_time=0.05, step_size=SAMPLE_TIME, output_interval=SAMPLE_TIME, input=signal
    )
    held = np.floor(64.0 * np.sin(60.0 * times)) / 64.0
    np.testing.assert_array_equal(result["out1"][1:], held[:-1])


def test_fmpy_simulates_a_trajectory(tmp_path: Path) -> None:
    """Left limits at the communication points."""
    swing = Swing()
    built = build_fmu(Motion(swing, ["axis"], "m"), tmp_path / "swing.fmu")  # type: ignore[arg-type]
    result = fmpy.simulate_fmu(str(built.path), step_size=0.01, output_interval=0.01)
    exact = swing.evaluate(result["time"], 2, "left")[:, :, 0]
    for row, kind in zip(exact, ("position", "velocity", "acceleration"), strict=True):
        np.testing.assert_allclose(result[f"axis.reference.{kind}"], row, rtol=0.0, atol=1e-12 * abs(exact).max())


def test_description_says_what_it_is(tmp_path: Path) -> None:
    """Outputs that jump are discrete, feedthrough is declared, and tools that look find sample time and breakpoints."""
    path = build_fmu(delay(sample_time=0.25, offset=0.125), tmp_path / "delay.fmu").path
    description = fmpy.read_model_description(str(path))
    output = next(each for each in description.modelVariables if each.causality == "output")
    assert (output.variability, output.initial, output.type) == ("discrete", "calculated", "Real")
    assert description.coSimulation.maxOutputDerivativeOrder in (None, 0)
    assert (description.defaultExperiment.stepSize, description.defaultExperiment.tolerance) == ("0.25", None)
    text = zipfile.ZipFile(path).read("modelDescription.xml").decode()
    assert '<Sampling sampleTime="0.25" offset="0.125"/>' in text
    path = build_fmu(Motion(Swing(), ["axis"], "m"), tmp_path / "swing.fmu").path  # type: ignore[arg-type]
    text = zipfile.ZipFile(path).read("modelDescription.xml").decode()
    assert '<Breakpoints times="0.0 0.4 1.0"/>' in text
    description = fmpy.read_model_description(str(path))
    limit = next(each for each in description.modelVariables if each.name == "limit")
    assert (limit.type, limit.min, limit.max, limit.start) == ("Integer", "1", "2", "1")


def test_trajectory_declares_no_derivatives(tmp_path: Path) -> None:
    """Importers stumble over declared derivatives without states: Maestro where both outputs are connected, libcosim always."""
    path = build_fmu(Motion(Swing(), ["axis"], "m"), tmp_path / "swing.fmu").path  # type: ignore[arg-type]
    description = fmpy.read_model_description(str(path))
    assert [each.name for each in description.modelVariables if each.derivative is not None] == []
    assert list(description.derivatives) == []


@pytest.mark.parametrize(
    ("declared", "dependencies"), [({}, ["in1", "in2"]), ({"out1": ("in2",)}, ["in2"]), ({"out1": ()}, [])]
)
def test_feedthrough_is_declared(declared: dict[str, tuple[str, ...]], dependencies: list[str], tmp_path: Path) -> None:
    """Masters sort their slaves by it; an output without a statement depends on all inputs."""
    controller = pd_controller()
    path = build_fmu(replace(controller, feedthrough=declared), tmp_path / "block.fmu").path
    unknown = fmpy.read_model_description(str(path)).outputs[0]
    assert [each.name for each in unknown.dependencies] == dependencies


@pytest.mark.slow
def test_equal_exports_are_equal_files(tmp_path: Path) -> None:
    """The same block gives the same bytes, and is found in the cache; any change makes another GUID."""
    first, second = (build_fmu(fir(), tmp_path / f"{name}.fmu", cache=name == "a") for name in "ab")
    assert first.path.read_bytes() == second.path.read_bytes()
    again = build_fmu(fir())
    assert again.cached
    assert again.guid == first.guid
    changed = [
        replace(fir(), sample_time=2e-3),
        replace(fir(), offset=1e-4),
        replace(fir(), states=(0.0, 0.0, 0.0, 1.0)),
    ]
    assert len({generate_sources(each, DefaultExperiment()).guid for each in [fir(), *changed]}) == 4
    one, two = (build_fmu(Motion(lame(bang_bang())), tmp_path / f"{name}.fmu", cache=name == "c") for name in "cd")
    assert one.path.read_bytes() == two.path.read_bytes()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"sample_time": 0.0}, "sample time of block 'fir' must be positive, got 0.0 s"),
        ({"offset": -1.0}, "offset of block 'fir' must be zero or positive, got -1.0 s"),
        ({"states": (0.0, float("nan"), 0.0, 0.0)}, "start value 1 of the states of block 'fir' must be finite"),
        ({"states": (0.0,)}, r"must take [(]x, u, p[)] of sizes [(]1, 1, 0[)]"),
        ({"feedthrough": {"out1": ("nothing",)}}, "names 'nothing', which is no input"),
        ({"parameters": (gain("in1", 0.0),)}, "more than once|must take"),
    ],
)
def test_contradictions_are_refused(change: dict[str, Any], sentence: str) -> None:
    """What was given, and what would be right, before any compiler runs."""
    with pytest.raises(ModelError, match=sentence):
        build_fmu(replace(fir(), **change))


def learning_table(states: int) -> SymbolicBlock:
    """A table of one value per sample of a cycle: read at the present sample, written with the error, as iterative learning
    does; its last state is the sample's number."""
    x, u, p = casadi.MX.sym("x", states + 1), casadi.MX.sym("u", 1), casadi.MX.sym("p", 0)
    table, number = x[:states], x[states]
    index = casadi.fmod(number, states)
    value = table[index]
    learned = casadi.if_else(casadi.DM(range(states)) == index, table + 0.5 * u, table)
    updated = casadi.vertcat(learned, number + 1)
    return SymbolicBlock(
        name="learning",
        description="A learning table",
        sample_time=SAMPLE_TIME,
        inputs=(Variable("in1", "1", "Error", "input", start=0.0),),
        outputs=(Variable("out1", "1", "Learned", "output"),),
        output=casadi.Function("output", [x, u, p], [value]),
        update=casadi.Function("update", [x, u, p], [updated]),
        states=(0.0,) * (states + 1),
        feedthrough={"out1": ()},
    )


def iterations(code: str) -> int:
    """How often the bodies of a block's loops are run in a sample, none of which is within another."""
    assert not re.search(r"for \(.*for \(", code)
    assert set(re.findall(r"^void (casadi_\w+)\(", code, re.MULTILINE)) <= {"casadi_copy"}
    return sum(map(int, re.findall(r"for \([^;]*; i<(\d+);", code)))


@pytest.mark.slow
def test_thousands_of_states(export: Export) -> None:
    """A table of 5000 states works, in C of as many loops as one of 1000 needs, each run as often as there are states."""
    table = learning_table(5000)
    large, small = (
        generate_sources(each, DefaultExperiment()).generated["model_sample.c"]
        for each in (table, learning_table(1000))
    )
    assert large.count(";") == small.count(";")
    assert iterations(large) == 5 * iterations(small) > 0
    instance = export(table)()
    inputs = np.random.default_rng(3).normal(size=(300, 1))
    np.testing.assert_array_equal(run(instance, inputs, SAMPLE_TIME), expected(table, inputs))
    instance.step(10.0, until=10.3)
    assert instance.samples() == 10_300


@pytest.mark.slow
def test_runs_are_copied_between_computed_states(export: Export) -> None:
    """Delay lines beside other states, one after the other, in both directions and shorter than a run."""
    mixed = block(
        "mixed",
        [0.01 * i for i in range(120)],
        2,
        lambda x, u, p: [x[0] + u[0], x[119]],
        lambda x, u, p: [
            0.5 * x[0] + u[0],
            *(x[i] for i in range(50)),  # one further
            x[3] * x[4],
            *(x[60 - i] for i in range(20)),  # backwards
            *(x[i] for i in range(100, 118)),  # and back by many
            u[1],
            *(x[i] for i in range(90, 119)),
        ],
    )
    inputs = np.random.default_rng(4).normal(size=(150, 2))
    assert "casadi_f1" in generate_sources(mixed, DefaultExperiment()).generated["model_sample.c"]
    np.testing.assert_array_equal(run(export(mixed)(), inputs, SAMPLE_TIME), expected(mixed, inputs))


@pytest.mark.slow
def test_thousands_of_statements(export: Export) -> None:
    """Where nothing can be copied the code is long, and GCC's optimiser must not take minutes over it."""
    many = block(
        "many",
        [1.0 + i for i in range(2000)],
        1,
        lambda x, u, p: [x[0] * u[0]],
        lambda x, u, p: [0.5 * x[i] + x[(7 * i) % 2000] * u[0] for i in range(2000)],
    )
    assert "optimize" in generate_sources(many, DefaultExperiment()).generated["model_sample.c"]
    inputs = np.random.default_rng(6).normal(size=(20, 1))
    exact = expected(many, inputs)
    np.testing.assert_allclose(run(export(many)(), inputs, SAMPLE_TIME), exact, rtol=1e-12)
