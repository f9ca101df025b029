"""The files: valid for others' tools, reproducible, found again, fast with thousands of states; and all slaves of a scene, whose system moves
as the scene does."""

from __future__ import annotations

import json
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
import tomlkit
from export_support.blocks import SAMPLE_TIME, block, delay, expected, fir, gain, pd_controller, quantiser
from export_support.instance import run
from export_support.trajectories import Swing, lame
from fmpy.validation import validate_fmu as validate_by_fmpy
from python_slave import PythonSlave
from typer.testing import CliRunner, Result

from flexfmu.cosim.cli.main import app
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.sampled_slave import fmu_slave
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import SlaveVariable
from flexfmu.cosim.engine.trajectory_slave import FmuTrajectory, TrajectorySlave
from flexfmu.cosim.exchange.slave_export import ExportedSystem, export_slaves
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.source_generation import generate_sources
from flexfmu.fmu_build.trajectory_build import Motion
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType
from flexfmu.fmu_build.validation.steps import interpolates_inputs
from flexfmu.fmu_build.validation.validate import validate_fmu
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
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
    assert "with derivative 1 of in1 out1 is 0.00775 off" in finding.message


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


PD = {"kind": "pd", "proportional": 5e3, "derivative": 60.0, "sample_time": 5e-4}


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A controlled robot with a shaper, an encoder and a payload that nobody knows of."""
    return load_scene("barnard2012-6kg").replace(
        {
            "cosimulation.drive": "torque",
            "cosimulation.step": 1e-3,
            "effects.motor_inertia": 0.1,
            "controller": [PD],
            "shaper": [{"kind": "zv", "apply": "sampled", "sample_time": 5e-4}],
            "imperfection": [
                {"kind": "encoder", "counts_per_turn": 1e5},
                {"kind": "payload-error", "relative": 0.1},
                {"kind": "lag", "time_constant": 2e-4, "sample_time": 5e-4},
            ],
        }
    )


@pytest.fixture(scope="module")
def exported(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> ExportedSystem:
    """Its FMUs."""
    return export_slaves(scene, tmp_path_factory.mktemp("fmus"))


def test_every_slave_has_an_fmu(exported: ExportedSystem) -> None:
    """Named after the slaves; the robot's has the scene's payload and is told of the true one."""
    names = ["trajectory", "plant", "pd", "shaper", "encoder", "lag"]
    assert [each.name for each in exported.slaves] == names
    assert [each.path.name for each in exported.slaves] == [f"{name}.fmu" for name in names]
    assert {each.name: each.parameters for each in exported.slaves if each.parameters} == {
        "plant": {"payload.mass": pytest.approx(6.6)}
    }
    assert ("pd.joint1.torque", "lag.joint1.torque.input") in exported.connections


def test_the_fmus_move_as_the_scene(scene: Scene, exported: ExportedSystem) -> None:
    """The same joint angles from FMUs alone, wired as the export says."""
    expected = run_scene(scene)
    assert expected.completed, expected.message
    trajectory, plant, *others = exported.slaves
    slaves: list[Any] = [
        TrajectorySlave(FmuTrajectory(trajectory.path)),
        FmuSlave(plant.path, plant.name, plant.parameters),
        *(fmu_slave(each.path, each.name, each.parameters) for each in others),
    ]
    simulation = simulate(connect(slaves, exported.connections), exported.stop_time, exported.step, tolerance=1e-6)
    assert simulation.outcome is Outcome.COMPLETED, simulation.message
    for joint in (1, 2):
        found = simulation.recording[f"plant.joint{joint}.position"].values
        np.testing.assert_allclose(found, expected.recording[f"joint{joint}.position"].values, rtol=0.0, atol=1e-9)


def test_one_slave_alone(scene: Scene, tmp_path: Path) -> None:
    """Chosen by name, with no connections to what isn't there; a name that isn't there is answered with those that are."""
    system = export_slaves(scene, tmp_path / "new", names=["pd"])
    assert [each.name for each in system.slaves] == ["pd"]
    assert system.connections == ()
    assert [each.name for each in (tmp_path / "new").iterdir()] == ["pd.fmu"]
    with pytest.raises(InputError, match="no slave 'pid' in this scene; slaves: trajectory, plant, pd, shaper"):
        export_slaves(scene, tmp_path, names=["pid"])


class Constant(PythonSlave):
    """A torque."""

    name = "mine"
    variables = (SlaveVariable("joint1.torque", "output", "N.m", 0.0),)


def test_python_classes_stay(scene: Scene, tmp_path: Path) -> None:
    """A class of the user's own has no equations: it is named before anything is written."""
    own = scene.replace({"controller": [Constant()], "imperfection": []})
    with pytest.raises(InputError, match=r"slave 'mine' is a Constant in Python .* SymbolicBlock"):
        export_slaves(own, tmp_path / "none")
    assert not (tmp_path / "none").exists()


TIME = {"sample_time": 1e-3}
CONTROLLED = {
    "cosimulation.drive": "torque",
    "controller": [
        {"kind": "pd", "proportional": 2e3, "derivative": 20.0, **TIME},
        {"kind": "feedforward", "name": "ahead", **TIME},
    ],
}


def fmus(*arguments: object) -> Result:
    """Run the command."""
    return CliRunner().invoke(app, ["fmus", *map(str, arguments)])


def test_slaves_of_a_scene(tmp_path: Path) -> None:
    """A table with a line for each, or JSON that says where they are and how they are connected; a name that isn't there is a
    mistake of usage that tells the others."""
    scene = tmp_path / "controlled.toml"
    scene.write_text(tomlkit.dumps(load_scene("barnard2012-6kg").replace(CONTROLLED).model_dump(exclude_none=True)))
    chosen = (scene, "--out", tmp_path / "out", "--slave", "pd", "--slave", "ahead")
    result = fmus(*chosen)
    assert result.exit_code == 0, result.stderr
    for part in ("pd.fmu", "0.001 s", "2 FMUs"):
        assert part in result.stdout
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"pd.fmu", "ahead.fmu"}
    for naming, dot in (("structured", "."), ("flat", "_")):
        found = json.loads(fmus(*chosen, "--naming", naming, "--json").stdout)
        assert {"from": f"ahead.joint1{dot}feedforward", "to": f"pd.joint1{dot}feedforward"} in found["connections"]
        assert [each["name"] for each in found["slaves"]] == ["pd", "ahead"]
        assert validate_fmu(Path(found["slaves"][1]["fmu"])) == []
    wrong = fmus(scene, "--out", tmp_path / "out", "--slave", "pid")
    assert wrong.exit_code == 2
    assert "slaves: trajectory, plant, pd, ahead" in wrong.stderr
