"""The files: valid for others' tools, reproducible, found again, and fast with thousands of states."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import blocks
import fmpy
import numpy as np
import pytest
from export_support.blocks import SAMPLE_TIME, block, delay, expected, fir, gain, pd_controller, quantiser
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
from flexfmu.trajectories.profiles import bang_bang

Export = Callable[..., Any]

SWING = Motion(Swing(), ["axis"], "m")  # type: ignore[arg-type]
MADE: list[Any] = [
    *(pytest.param(make, id=make.__name__) for make in (pd_controller, fir, delay, quantiser)),
    pytest.param(lambda: Motion(lame(bang_bang())), id="trajectory", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("make", MADE)
def test_export_is_valid(make: Callable[[], Any], tmp_path: Path) -> None:
    """Other tools check more than ours: description by fmpy, symbols, and a short life in a process of its own."""
    made = make()
    times = {} if isinstance(made, Motion) else {"stop_time": 0.05}
    built = build_fmu(made, tmp_path / "exported.fmu", **times)
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
    path = build_fmu(SWING, tmp_path / "swing.fmu").path
    text = zipfile.ZipFile(path).read("modelDescription.xml").decode()
    assert '<Breakpoints times="0.0 0.4 1.0"/>' in text
    description = fmpy.read_model_description(str(path))
    limit = next(each for each in description.modelVariables if each.name == "limit")
    assert (limit.type, limit.min, limit.max, limit.start) == ("Integer", "1", "2", "1")
    # importers stumble over derivatives without states: Maestro where both outputs are connected, libcosim always
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


def test_each_kind_has_its_own_runtime() -> None:
    """An FMU carries the sources that it is built from, and no integrator where nothing is integrated."""
    made, trajectory = (set(generate_sources(each, DefaultExperiment()).runtime) for each in (pd_controller(), SWING))
    assert {"block.c", "inputs.c"} <= made
    assert "trajectory.c" in trajectory
    assert not {name for name in made | trajectory if name.startswith(("integrator", "plant", "stages", "linear"))}
    assert not {name for name in trajectory if name.startswith(("block", "inputs"))}


@pytest.mark.slow
def test_equal_exports_are_equal_files(tmp_path: Path) -> None:
    """The same block gives the same bytes, and is found in the cache; any change makes another GUID."""
    first, second = (build_fmu(fir(), tmp_path / f"{name}.fmu", cache=name == "a") for name in "ab")
    assert first.path.read_bytes() == second.path.read_bytes()
    again = build_fmu(fir())
    assert again.cached
    assert again.guid == first.guid
    changes: tuple[dict[str, Any], ...] = (
        {},
        {"sample_time": 2e-3},
        {"offset": 1e-4},
        {"states": (0.0, 0.0, 0.0, 1.0)},
    )
    assert len({generate_sources(replace(fir(), **each), DefaultExperiment()).guid for each in changes}) == 4
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


def iterations(code: str) -> int:
    """How often the bodies of a block's loops are run in a sample, none of which is within another."""
    assert not re.search(r"for \(.*for \(", code)
    assert set(re.findall(r"^void (casadi_\w+)\(", code, re.MULTILINE)) <= {"casadi_copy"}
    return sum(map(int, re.findall(r"for \([^;]*; i<(\d+);", code)))


@pytest.mark.slow
def test_thousands_of_states(export: Export) -> None:
    """A law that learns 5000 states works, in C of as many statements and iterations as one of 1000 needs."""
    large, small = (
        blocks.learning(gain=1.0, cycles=2, period=states / 2 * SAMPLE_TIME, sample_time=SAMPLE_TIME)
        for states in (5000, 1000)
    )
    codes = [generate_sources(each, DefaultExperiment()).generated["model_sample.c"] for each in (large, small)]
    assert codes[0].count(";") == codes[1].count(";")
    assert iterations(codes[0]) == iterations(codes[1]) > 0
    instance = export(large)()
    inputs = np.random.default_rng(3).normal(size=(300, len(large.inputs)))
    np.testing.assert_array_equal(run(instance, inputs, SAMPLE_TIME), expected(large, inputs))
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
