"""Gain scheduling: factors on gains against `numpy.interp`, in a loop, over the payload, and what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from blocks import cascade, pd, pid, responses
from numpy.typing import NDArray
from python_slave import PythonSlave

import flexfmu
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicBlock

Array = NDArray[np.float64]

H = 1e-3
AT = [-1.0, 0.5, 2.0]
RISING: dict[str, Any] = {"over": "load", "at": AT, "proportional": [1.0, 2.0, 3.0]}


def test_gains_follow_the_signal() -> None:
    """Linear between the values, constant beyond, for each joint; gains without a table stay."""
    rng = np.random.default_rng(0)
    schedule = {"over": "load", "at": AT, "proportional": [1.0, (2.0, 0.5), 0.0]}
    block = pd([50.0, 70.0], [2.0, 3.0], sample_time=H, schedule=schedule)
    signals = {each.name: rng.normal(scale=2.0, size=200) for each in block.inputs}
    found = responses(block, signals)
    for joint, k_p, k_d, table in (("joint1", 50.0, 2.0, [1.0, 2.0, 0.0]), ("joint2", 70.0, 3.0, [1.0, 0.5, 0.0])):
        factor = np.interp(signals["load"], AT, table)
        expected = (
            factor * k_p * (signals[f"{joint}.reference.position"] - signals[f"{joint}.position"])
            + k_d * (signals[f"{joint}.reference.velocity"] - signals[f"{joint}.velocity"])
            + signals[f"{joint}.feedforward"]
        )
        np.testing.assert_allclose(found[f"{joint}.torque"], expected, rtol=1e-13, atol=1e-12)
    assert block.feedthrough["joint1.torque"][-1] == "load"


def test_an_input_that_it_has_already() -> None:
    """Gains over the measured angle take the angle that the controller reads."""
    block = pd(50.0, 0.0, sample_time=H, schedule={**RISING, "over": "joint1.position"})
    assert [each.name for each in block.inputs].count("joint1.position") == 1
    angles = np.linspace(-2.0, 3.0, 41)
    expected = -50.0 * np.interp(angles, AT, [1.0, 2.0, 3.0]) * angles
    np.testing.assert_allclose(
        responses(block, {"joint1.position": angles})["joint1.torque"], expected, rtol=1e-13, atol=1e-12
    )


def velocity_loop(schedule: Any) -> SymbolicBlock:
    """The velocity loop of a cascade."""
    velocity = {"proportional": 9.0, "integral": 400.0, "schedule": schedule}
    loops: tuple[SymbolicBlock, ...] = cascade({"proportional": 1.0}, velocity, torque_limit=5.0, sample_time=H)
    return loops[1]


@pytest.mark.parametrize("make", [
    lambda schedule: pid(40.0, 300.0, 2.0, sample_time=H, filter_time=2e-3, torque_limit=30.0, schedule=schedule),
    velocity_loop,
], ids=["pid", "velocity loop"])  # fmt: skip
def test_states_and_clock_stay(make: Callable[[Any], SymbolicBlock]) -> None:
    """A constant signal makes a controller with constant gains, states, limits and anti-windup included."""
    controller = make(None)
    schedule = {"over": "load", "at": [0.0, 1.0], "integral": [0.0, 2.0], "proportional": [1.0, 3.0]}
    rng = np.random.default_rng(1)
    signals = {each.name: rng.normal(size=100) for each in controller.inputs}
    found = responses(make(schedule), {**signals, "load": np.full(100, 0.25)})
    changed = {"integral_gain": 0.5, "proportional_gain": 1.5}
    gains = {f"joint{i}.{key}": np.full(100, factor) for i in (1, 2) for key, factor in changed.items()}
    gains = {each.name: gains[each.name] * each.start for each in controller.parameters if each.name in gains}
    expected = responses(controller, signals | gains)
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-12, atol=1e-12)


SCHEDULE: dict[str, Any] = {"over": "end_effector.position.x", "at": [-0.2, 0.0, 0.2], "proportional": [0.6, 1.0, 1.4]}
PD: dict[str, Any] = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": H, "schedule": SCHEDULE}


def test_gains_over_the_pose_in_a_loop(robot: Scene) -> None:
    """The torque of each sample is that of the gains at the pose of the sample."""
    recording = run_scene(robot.replace({"controller": [PD]})).recording
    at = np.searchsorted(recording.time, H * np.arange(400) + 1e-9) - 1
    factor = np.interp(recording["end_effector.position.x"].values[at], SCHEDULE["at"], SCHEDULE["proportional"])
    assert np.ptp(factor) > 0.5
    for joint in ("joint1", "joint2"):
        signals = ("reference.position", "position", "reference.velocity", "velocity", "torque")
        q_r, q, v_r, v, torque = (recording[f"{joint}.{each}"].values[at] for each in signals)
        expected = 1e4 * factor * (q_r - q) + 100.0 * (v_r - v)
        np.testing.assert_allclose(torque, expected, rtol=0.0, atol=1e-12 * abs(expected).max())


class Load(PythonSlave):
    """Outputs the payload, which changes at 0.2 s."""

    name = "load"
    sample_time = H
    variables = (SlaveVariable("payload.mass", "output", "kg"),)

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.mass = 2.0

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = self.mass

    def sample(self, time: float) -> None:
        self.mass = 2.0 if time < 0.2 else 6.0


def test_gains_over_the_payload(robot: Scene) -> None:
    """Where no slave outputs a payload the gains are those of the scene's; otherwise they follow it."""
    table = {"over": "payload.mass", "at": [0.0, 8.0], "proportional": [1.0, 3.0]}
    scene = robot.replace({"controller": [{**PD, "schedule": table}]})
    alone = run_scene(scene).recording
    followed = flexfmu.run(robot, controllers=[Load(), *loop_of(scene).controllers]).recording
    for recording, factors in ((alone, (2.5, 2.5)), (followed, (1.5, 2.5))):
        for instant, factor in zip((0.1, 0.3), factors, strict=True):
            at = np.searchsorted(recording.time, instant + 1e-9) - 1
            signals = ("reference.position", "position", "reference.velocity", "velocity", "torque")
            q_r, q, v_r, v, torque = (recording[f"joint1.{each}"].values[at] for each in signals)
            assert torque == pytest.approx(1e4 * factor * (q_r - q) + 100.0 * (v_r - v), rel=1e-11)


def test_loops_of_a_cascade_have_their_own(robot: Scene) -> None:
    """Both loops take the signal."""
    table = {"over": "joint1.position", "at": [1.0, 3.0], "velocity_feedforward": [1.0, 0.9]}
    position = {"proportional": 60.0, "schedule": table}
    velocity = {"proportional": 90.0, "schedule": {**SCHEDULE, "inertia": [1.0, 2.0, 3.0]}}
    cascade = {"kind": "cascade", "position": position, "velocity": velocity, "sample_time": H}
    outer, inner = loop_of(robot.replace({"controller": [cascade]})).controllers
    assert isinstance(outer, BlockSlave)
    assert [each.name for each in outer.block.inputs].count("joint1.position") == 1
    assert "end_effector.position.x" in {each.name for each in inner.variables}


@pytest.mark.parametrize(("change", "message"), [
    ({"at": [0.0]}, r"`at` must be two or more ascending values of end_effector.position.x, got \[0\.0\]"),
    ({"at": [0.2, 0.0, -0.2]}, "ascending values"),
    ({"proportional": [1.0, 2.0]}, "`proportional` must have one factor at each of `at`, 3, got 2"),
    ({"proportional": [1.0, -2.0, 1.0]}, r"proportional.*must be at least 0\.0"),
    ({"integral": [1.0, 1.0, 1.0]}, "integral"),
    ({"proportional": None}, "the schedule has no table: give one factor at each of `at` for proportional, derivative"),
])  # fmt: skip
def test_scenes_are_refused(robot: Scene, change: dict[str, Any], message: str) -> None:
    """The key, its value and what would be right."""
    table = {key: value for key, value in {**SCHEDULE, **change}.items() if value is not None}
    with pytest.raises(SceneError, match=message):
        robot.replace({"controller": [{**PD, "schedule": table}]})


def test_an_own_output_is_no_signal_to_follow() -> None:
    """The torque depends on the gains."""
    with pytest.raises(InputError, match=r"its gains can't follow its own output joint1\.torque"):
        pd(1.0, 1.0, sample_time=H, schedule={**RISING, "over": "joint1.torque"})


def test_a_signal_that_there_isnt(robot: Scene) -> None:
    """A misspelt signal has no source."""
    misspelt = {**SCHEDULE, "over": "end_efector.position.x"}
    with pytest.raises(InputError, match=r"end_efector.position.x.* has no source.*mean 'end_effector.position.x'"):
        run_scene(robot.replace({"controller": [{**PD, "schedule": misspelt}]}))
