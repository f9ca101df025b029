"""What the keys of controllers, imperfections and co-simulation do, where files of a scene are looked for, and what the FMU's parameters and
numbered choices are called in a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from blocks import pd
from fmpy import read_model_description

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.engine.errors import FmuFileError, InputError
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.sampled_slave import SampledFmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.fmu.variables import settable_variables, settings
from flexfmu.cosim.engine.master.couplings import GaussSeidel, Implicit, Jacobi
from flexfmu.cosim.engine.master.iteration import Anderson, FixedPoint
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.slave import Slave
from flexfmu.cosim.experiment.parameters import holding_torques, scene_parameters, scene_with_parameters
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.system import CouplingMethod, coupling_of
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.signals import cycle_errors
from flexfmu.fmu_build.archive import pack
from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

PD = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
SHIPPED = Path(__file__).parents[3] / "model" / "scene" / "scenes" / "barnard2012-6kg.toml"


def imperfections(robot: Scene, *sections: dict[str, Any]) -> list[Slave]:
    """The slaves of imperfections behind a PD controller."""
    loop = loop_of(robot.replace({"controller": [PD], "imperfection": list(sections)}))
    return [inline.slave for inline in loop.inline_blocks]


def response(slave: Any, signal: Any) -> Any:
    """(N,) first output to a signal (N,) at the first input, from its initial values on."""
    output = np.array([next(i for i, each in enumerate(slave.variables) if each.causality == "output")])
    found, value = [], np.empty(1)
    slave.initialize(0.0, 1.0, None)
    for k, u in enumerate(signal):
        slave.set(np.array([0]), np.array([float(u)]))
        slave.sample(k * slave.sample_time)
        slave.get(output, value)
        found.append(float(value[0]))
    return np.array(found)


def test_noise_sections_have_numbers_of_their_own(robot: Scene) -> None:
    """Two sections on one signal don't give the same noise twice, but each gives the same in every run."""
    noise = {"kind": "noise", "signal": "position", "standard_deviation": 1e-3}
    first, second = imperfections(robot, noise, noise)
    assert [first.name, second.name] == ["noise", "noise2"]
    zeros = np.zeros(400)
    one, other = response(first, zeros), response(second, zeros)
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.15
    np.testing.assert_array_equal(response(imperfections(robot, noise)[0], zeros), one)
    late = {"kind": "jitter", "time": 1e-3}
    jitters = [response(each, np.arange(200.0)) for each in imperfections(robot, late, late | {"signal": "velocity"})]
    assert abs(np.corrcoef(*(each[1:] - np.arange(1.0, 200.0) for each in jitters))[0, 1]) < 0.25


@pytest.mark.parametrize(("keys", "expected"), [
    ({}, CouplingMethod(GaussSeidel(), None, None)),
    ({"algorithm": "jacobi"}, CouplingMethod(Jacobi(), None, None)),
    ({"algorithm": "implicit", "loop_solver": {"kind": "fixed-point", "relaxation": 0.5, "iterations": 7}},
     CouplingMethod(Implicit(FixedPoint(0.5, rounds=7)), FixedPoint(0.5, rounds=7), None)),
    ({"loop_solver": {"kind": "anderson", "iterations": 9}}, CouplingMethod(GaussSeidel(), Anderson(rounds=9), None)),
    ({"step_control": {"tolerance": 1e-3, "minimum": 1e-7, "maximum": 2e-3}},
     CouplingMethod(GaussSeidel(), None, StepDoubling(1e-3, smallest=1e-7, largest=2e-3))),
])  # fmt: skip
def test_coupling_keys(robot: Scene, keys: dict[str, Any], expected: CouplingMethod) -> None:
    """Algorithm, solver and step control of the master are what the scene names."""
    scene = robot.replace({f"cosimulation.{key}": value for key, value in keys.items()})
    assert coupling_of(scene.cosimulation) == expected


def test_specified_insensitivity(robot: Scene) -> None:
    """The band that a scene names is kept, at the price of a longer motion than ZV's."""
    section = {"kind": "si", "band": [45.0, 70.0], "tolerance": 0.08, "apply": "sampled", "sample_time": 1e-3}
    loop = loop_of(robot.replace({"shaper": [section]}))
    (shaper,) = (inline.slave for inline in loop.inline_blocks)
    response_to_one = np.diff(response(shaper, np.append(0.0, np.ones(80))))
    frequencies = np.linspace(46.0, 69.0, 100)
    vibration = abs(np.exp(2j * np.pi * np.outer(frequencies, 1e-3 * np.arange(80))) @ response_to_one)
    assert 0.05 < vibration.max() < 0.09
    assert loop.motion.duration - plan(robot).duration > 0.5 / 57.5


PID = {"kind": "pid", "proportional": 1e4, "integral": 1e5, "derivative": 100.0, "sample_time": 1e-3}


@pytest.mark.parametrize(("pid", "others", "first"), [
    ({"setpoint_weight": 0.5}, [], 1.0),
    ({"setpoint_weight": 0.9, "torque_limit": 80.0, "anti_windup": "none"}, [], 1.0),
    ({"setpoint_weight": 0.0}, [{"kind": "gravity-feedforward", "sample_time": 1e-3}], 1.0),
    ({}, [], 1.0),
    ({"setpoint_weight": 0.5, "initial_torque": 0.0}, [], 0.0),
    ({"setpoint_weight": 0.5, "integral": 0.0}, [], 0.0),
])  # fmt: skip
def test_pid_starts_without_a_bump(robot: Scene, pid: Any, others: list[Any], first: float) -> None:
    """The torque begins at the static one, or where `initial_torque` says, and a weight only makes it smaller."""
    torques = []
    for controllers in ([PID | pid, *others], [PID]):
        run = run_scene(robot.replace({"controller": controllers}))
        assert run.completed, run.message
        torques.append(np.array([run.recording[f"joint{i}.torque"].values for i in (1, 2)]))
    static = np.array(list(holding_torques(robot).values()))
    np.testing.assert_allclose(torques[0][:, 0], first * static, rtol=1e-3, atol=1e-9)
    assert abs(torques[0]).max() < 1.1 * abs(torques[1]).max()


LEARNING = {"kind": "learning", "gain": 4e3, "lead": 4, "cycles": 2, "sample_time": 1e-3}


def test_learning_repeats_the_motion(robot: Scene) -> None:
    """There and back in cycles of whole samples, however long a shaper makes the motion; the error shrinks, and the
    results tell it for each cycle."""
    scene = robot.replace(
        {
            "controller": [PD, LEARNING],
            "shaper": [{"kind": "zv", "modes": [{"frequency": 58.0}]}],
            "trajectory.duration": 0.5,
            "cosimulation.step": 1e-3,
        }
    )
    run = run_scene(scene)
    assert run.completed, run.message
    repetition = run.plan.repetition
    assert repetition is not None
    assert repetition.period / 1e-3 == pytest.approx(round(repetition.period / 1e-3), abs=1e-9)
    assert 0.0 <= repetition.period / 2.0 - (0.5 + 0.5 / 58.0 + 0.1) < 1e-3
    first, second = cycle_errors(run.plan, run.recording)
    assert second.rms[0] < 0.8 * first.rms[0]
    assert second.rms[1] < 0.8 * first.rms[1]
    assert max(second.rms) < max(second.largest)


def test_learning_controllers_share_their_motion(robot: Scene) -> None:
    """Different numbers of cycles can't both be."""
    sections = [PD, LEARNING, LEARNING | {"cycles": 3, "name": "other"}]
    with pytest.raises(InputError, match=r"the same `cycles`, got \[2, 3\]"):
        loop_of(robot.replace({"controller": sections}))


CONTROLLERS = """
import flexfmu

def damper(gain):
    @flexfmu.controller(sample_time=1e-3, name="damper")
    def pd(reference, measurement, *, kp=gain, kd={derivative}):
        error = reference - measurement
        return kp * error[:2] + kd * error[2:]
    return pd
"""


def scene_in(folder: Path, section: str) -> Scene:
    """A torque-driven scene in a file of its own."""
    folder.mkdir(exist_ok=True)
    text = SHIPPED.read_text(encoding="utf-8").replace('drive = "motion"', 'drive = "torque"')
    (folder / "scene.toml").write_text(f"{text}\n[[controller]]\n{section}", encoding="utf-8")
    return load_scene(folder / "scene.toml")


def test_fmus_are_found_beside_the_scene(tmp_path: Path) -> None:
    """Wherever the command is started, and also when values of the scene are replaced afterwards."""
    build_fmu(pd(1e3, 10.0, sample_time=1e-3), tmp_path / "mine" / "pd.fmu")
    scene = scene_in(tmp_path / "mine", 'kind = "fmu"\npath = "pd.fmu"')
    (slave,) = loop_of(scene.replace({"payload.mass": 1.0})).controllers
    assert isinstance(slave, SampledFmu)
    assert slave.path == tmp_path / "mine" / "pd.fmu"


def test_modules_are_found_beside_the_scene(tmp_path: Path) -> None:
    """Two scenes in different folders have different modules of the same name."""
    found = []
    for derivative in (10.0, 20.0):
        folder = tmp_path / f"scene{derivative:g}"
        scene = scene_in(folder, 'kind = "python"\nsource = "own_controllers:damper"\narguments = { gain = 5.0 }')
        (folder / "own_controllers.py").write_text(CONTROLLERS.format(derivative=derivative), encoding="utf-8")
        (slave,) = loop_of(scene).controllers
        assert isinstance(slave, BlockSlave)
        found.append([each.start for each in slave.block.parameters])
    assert found == [[5.0, 10.0], [5.0, 20.0]]


DAMPING: dict[str, dict[str, Any]] = {
    "damping.ratio": {"kind": "modal", "ratio": 0.01},
    "damping.rate": {"kind": "mass", "rate": 2.0},
    "damping.time": {"kind": "stiffness", "time": 1e-4},
}
"""Parameter → the section that has it."""


def complete(damping: str) -> Scene:
    """A scene in which everything has a value."""
    changes = {
        "effects.motor_inertia": 0.1,
        "effects.joint_friction": {"viscous": 0.2, "coulomb": 0.3},
        "effects.transmission": {"stiffness": 1e5, "damping": 2.0},
        "effects.gravity": [0.5, -9.81],
        "effects.damping": DAMPING[damping],
        "payload.inertia": 0.01,
    }
    return load_scene("barnard2012-6kg").replace(changes)


@pytest.mark.parametrize("name", sorted(scene_parameters(complete("damping.ratio"))))
def test_a_changed_parameter_is_that_of_the_robot(name: str) -> None:
    """Metrics are taken from the robot that was simulated: each parameter changes its own key and no other."""
    scene = complete(name if name in DAMPING else "damping.ratio")
    before = scene_parameters(scene)
    changed = before | {name: 1.01 * before[name] + 1e-3 * (before[name] == 0.0)}
    after = scene_parameters(scene_with_parameters(scene, {name: changed[name]}))
    assert after == (before if name.startswith("start.") else changed)


def test_parameters_of_no_robot_are_left_out() -> None:
    """An FMU has more of them, integrators for example."""
    scene = complete("damping.ratio")
    assert scene_with_parameters(scene, {"integrator.fixed_step": 1e-4, "start.x": 0.1}) == scene


@pytest.fixture(scope="module")
def shipped() -> Path:
    """The FMU of a shipped scene."""
    return build_scene(load_scene("barnard2012-6kg")).path


@pytest.mark.parametrize(("parameters", "numbers"), [
    ({"initial": "static", "integrator": "automatic"}, [1, 1]),
    ({"initial": "undeformed", "integrator": "radau3"}, [2, 5]),
    ({"initial": 2, "integrator": 7}, [2, 7]),
])  # fmt: skip
def test_names_stand_for_numbers(shipped: Path, parameters: dict[str, int | str], numbers: list[int]) -> None:
    """A script says what it means; importers without the names give the numbers."""
    found = settings(settable_variables(open_fmu(shipped).description), parameters)
    assert [setting.value for setting in found] == numbers
    assert {setting.handle.kind for setting in found} == {"Integer"}


def items_of(variable: Any) -> dict[str, int]:
    """Names and numbers of an enumeration."""
    return {item.name: int(item.value) for item in variable.declaredType.items}


def test_choices_are_enumerations_on_request(tmp_path: Path) -> None:
    """The same numbers behind names that every tool with enumerations shows; fmpy finds nothing wrong."""
    scene = load_scene("barnard2012-6kg")
    path = build_scene(scene, enumerations=True, output=tmp_path / "enumerations.fmu").path
    variables = {each.name: each for each in read_model_description(str(path), validate=True).modelVariables}
    items = items_of(variables["integrator"])
    assert (variables["integrator"].type, items["radau3"], items["rk4"]) == ("Enumeration", 5, 7)
    found = settings(settable_variables(open_fmu(path).description), {"initial": "undeformed", "integrator": 5})
    assert [setting.value for setting in found] == [2, 5]
    starts = {"initial": items_of(variables["initial"])["undeformed"]}
    result = fmpy.simulate_fmu(str(path), stop_time=1e-3, start_values=starts, output=["link11.bending[1]"])
    assert result["link11.bending[1]"][0] == 0.0


def test_wrong_choices_are_refused(shipped: Path, tmp_path: Path) -> None:
    """Before anything runs, with what would be right; an annotation that somebody spoilt is no reason to set something else."""
    for parameters, message in (
        ({"initial": "sttic"}, "initial must be one of static, undeformed, got 'sttic'"),
        ({"integrator": 9}, "integrator must be at least 1 and at most 8, got 9"),
        ({"payload.mass": "static"}, "payload.mass is a number, got 'static'"),
    ):
        with pytest.raises(InputError, match=message):
            FmuSlave(shipped, parameters=parameters)
    folder = open_fmu(shipped).folder
    files = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    text = files["modelDescription.xml"].decode().replace("static=1", "static=one")
    spoilt = tmp_path / "spoilt.fmu"
    spoilt.write_bytes(pack(files | {"modelDescription.xml": text.encode()}))
    with pytest.raises(FmuFileError, match="its Choices are"):
        FmuSlave(spoilt)
