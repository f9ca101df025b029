"""Scenes that are driven by torques: they start at rest, follow their plan, and say what happened; several feedforwards are added; loops that
are unstable are called so, whatever ends their runs, and no others."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import cont2discrete
from typer.testing import CliRunner

import flexfmu
from flexfmu.cosim.cli import run as command
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.engine.errors import LoopWarning, WiringError
from flexfmu.cosim.engine.master.simulator import Outcome
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.experiment.parameters import holding_torques
from flexfmu.cosim.experiment.run_checks import divergence
from flexfmu.cosim.experiment.scene_loop import counted_twice, loop_of
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.metric_table import COMMON_METRICS, LOOP_METRICS
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.reports.summary import summarise
from flexfmu.model.linear import linearize
from flexfmu.model.scene.schema import Scene


@pytest.fixture(scope="module")
def run(controlled: Scene) -> Run:
    """The computed-torque loop."""
    return run_scene(controlled)


def values(run: Run) -> dict[str, float | None]:
    """Metrics."""
    return {name: measurement.value for name, measurement in measure_run(run, companions=0).items()}


def test_without_a_controller_the_robot_stays_where_it_is(robot: Scene) -> None:
    """The static torques hold the start pose: nothing moves, so the start of every loop is at rest."""
    run = run_scene(robot.replace({"trajectory.dwell": 0.0, "cosimulation.step": 1e-3}))
    assert run.completed
    for joint in (1, 2):
        angle = run.recording[f"joint{joint}.position"].values
        assert abs(angle - angle[0]).max() < 1e-9
        np.testing.assert_array_equal(
            run.recording[f"joint{joint}.torque"].values, holding_torques(robot)[f"joint{joint}.torque"]
        )


def test_a_controller_of_one_motor(robot: Scene) -> None:
    """The other motor holds the start pose of this robot, whatever robot its FMU was built for, and everything is measured."""
    inputs = ["joint1.reference.position", "joint1.position", "joint1.velocity"]
    law = {"A": [[0.0]], "B": [[0.0, 0.0, 0.0]], "C": [[0.0]], "D": [[5e3, -5e3, -100.0]], "sample_time": 1e-3}
    one = {"kind": "state-space", "inputs": inputs, "outputs": ["joint1.torque"], **law}
    scene = robot.replace({"payload.mass": 2.0, "controller": [one], "cosimulation.step": 1e-3})
    run = run_scene(scene)
    assert run.completed
    holding = holding_torques(scene)["joint2.torque"]
    np.testing.assert_array_equal(run.recording["joint2.torque"].values, holding)
    found = values(run)
    assert list(found) == [*COMMON_METRICS, *LOOP_METRICS]
    assert found["peak_torque_2"] == abs(holding)
    # the motor that nothing controls is off its reference, but in no loop
    assert run.health.unstable_loop is None
    assert abs(run.recording["joint2.velocity"].values).max() > 1.0
    assert summarise(run, {})["units"]["joint2.torque"] == "N.m"


def test_computed_torque_follows_the_plan(run: Run) -> None:
    """At 1 kHz the joints stay within a milliradian, and the robot vibrates hardly more than a perfect controller lets it."""
    found = values(run)
    assert run.completed
    assert list(found) == [*COMMON_METRICS, *LOOP_METRICS]
    assert 0.0 < (found["peak_tracking_error_1"] or 1.0) < 1e-3
    assert (found["rms_tracking_error_2"] or 1.0) < (found["peak_tracking_error_2"] or 0.0)
    assert (found["residual_vibration_amplitude"] or 1.0) < 2e-5


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
@pytest.mark.parametrize("offset", [0.0, 5e-4])
def test_first_row_is_the_standstill(robot: Scene, controlled: Scene, offset: float) -> None:
    """Left of the start, and until a late first sample, every slave puts out what it makes of the robot at rest: the
    controller behind an encoder sees the true angles, so its torques hold the robot but for the encoder's step and the
    links' sag, and the jump of the reference acceleration comes with the first sample."""
    sections = {
        "controller.computed-torque.offset": offset,
        "imperfection": [{"kind": "encoder", "counts_per_turn": 1e7}],
        "trajectory.profile": {"kind": "bang-bang"},
        "trajectory.dwell": 0.0,
        "trajectory.duration": 0.8,
        "cosimulation.step": 5e-4,
    }
    recording = run_scene(controlled.replace(sections)).recording
    before = recording.time < offset if offset else np.arange(recording.time.size) < 1
    for joint in (1, 2):
        torque, angle = (recording[f"joint{joint}.{kind}"].values for kind in ("torque", "position"))
        held = holding_torques(robot)[f"joint{joint}.torque"]
        np.testing.assert_allclose(torque[before], held, rtol=2e-4)
        assert abs(torque[np.argmin(before)] - held) > 1.0 or offset
        np.testing.assert_allclose(angle[before], angle[0], rtol=0.0, atol=1e-8)
        encoded = recording[f"encoder.joint{joint}.position"].values
        np.testing.assert_allclose(encoded[before], angle[before], rtol=0.0, atol=np.pi / 1e7)


def test_peak_torque_is_that_of_the_acting_torque(run: Run) -> None:
    """The torque that acts on the robot is the controller's, held between its samples."""
    time, torque = run.recording.time, run.recording["joint1.torque"].values
    np.testing.assert_array_equal(torque, run.recording["computed_torque.joint1.torque"].values)
    assert values(run)["peak_torque_1"] == abs(torque[time <= run.plan.duration]).max()
    assert abs(np.diff(torque)[np.diff(time) > 0.0]).max() == 0.0


def test_a_payload_error_is_known_to_the_robot_alone(controlled: Scene, run: Run) -> None:
    """The heavier robot lags behind, its controller reckons with the scene's payload, and its equilibrium is its own."""
    heavy = run_scene(controlled.replace({"imperfection": [{"kind": "payload-error", "relative": 0.3}]}))
    assert heavy.scene.payload.mass == 6.0
    assert heavy.robot.payload.mass == pytest.approx(7.8)
    assert (values(heavy)["peak_tracking_error_1"] or 0.0) > 5.0 * (values(run)["peak_tracking_error_1"] or 1.0)
    by_python = flexfmu.run(
        controlled,
        controllers=loop_of(controlled).controllers,
        imperfections=[flexfmu.imperfections.payload_error(relative=0.3)],
    )
    np.testing.assert_array_equal(by_python.recording["joint1.torque"].values, heavy.recording["joint1.torque"].values)


def test_the_summary_lists_slaves_and_delays(run: Run) -> None:
    """Which signal is late by how much is part of the result."""
    summary = summarise(run, measure_run(run, companions=0))
    assert [slave["name"] for slave in summary["slaves"]] == ["trajectory", "plant", "computed_torque"]
    assert summary["slaves"][2]["sample_time"] == 1e-3
    delays = {delay["connection"]: delay for delay in summary["delays"]}
    assert all(delay["seconds"] == 0.0 for delay in delays.values())
    assert (
        "read at the sample instants"
        in delays["plant.joint1.position -> computed_torque.joint1.position"]["description"]
    )


QUITTER = """
import os
import flexfmu

@flexfmu.controller(sample_time=1e-3, symbolic=False)
def quitter(t, reference):
    if t > 0.01 - 1e-9:
        os._exit(0)
    return [0.0, 0.0]
"""


@pytest.mark.skipif(sys.platform != "linux", reason="isolation needs Linux")
def test_a_slave_that_ends_the_process_leaves_results(
    robot: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command ends with status 1, the slave's name and the time, and writes all that was recorded."""
    (tmp_path / "quitter.py").write_text(QUITTER)
    section = {"kind": "python", "source": "quitter:quitter", "folder": str(tmp_path)}
    monkeypatch.setattr(
        command.console, "load_changed", lambda source, changes: robot.replace({"controller": [section]})
    )
    assert command.run("quitter.toml", tmp_path, json=True) == 1
    assert "quitter failed at 0.01 s: it ended its process with exit status 0" in capsys.readouterr().err
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["health"]["outcome"], summary["health"]["end_time"]) == ("step failed", pytest.approx(0.01))
    recording = Recording.read_csv(tmp_path / "results.csv")
    assert recording.time[-1] == pytest.approx(0.01)
    assert recording["joint1.position"].values.size > 50


PD = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
GRAVITY = {"kind": "gravity-feedforward", "sample_time": 2e-3}
FRICTION = {"kind": "friction-compensation", "viscous": 2.0, "sample_time": 5e-4, "offset": 1e-4}


def connections(run: Run) -> set[str]:
    """The connections of a run, as "output -> input"."""
    return {each.connection for each in run.delays}


def test_the_controller_adds_both(robot: Scene) -> None:
    """The torque of each sample is that of the PD and both feedforwards as they are at its instants, at their own rates."""
    run = run_scene(robot.replace({"controller": [PD, GRAVITY, FRICTION]}))
    assert run.completed, run.message
    assert connections(run) >= {
        "feedforward_sum.joint1.feedforward -> pd.joint1.feedforward",
        "gravity_feedforward.joint1.feedforward -> feedforward_sum.gravity_feedforward.joint1.feedforward",
    }
    recording = run.recording
    at = np.searchsorted(recording.time, 1e-3 * np.arange(400) + 1e-9) - 1
    for joint in ("joint1", "joint2"):
        signals = ("reference.position", "position", "reference.velocity", "velocity")
        q_r, q, v_r, v = (recording[f"{joint}.{each}"].values[at] for each in signals)
        terms = [
            recording[f"{name}.{joint}.feedforward"].values[at]
            for name in ("gravity_feedforward", "friction_compensation")
        ]
        expected = 1e4 * (q_r - q) + 100.0 * (v_r - v) + terms[0] + terms[1]
        assert min(abs(each).max() for each in terms) > 1.0
        np.testing.assert_allclose(
            recording[f"{joint}.torque"].values[at], expected, rtol=0.0, atol=1e-12 * abs(expected).max()
        )


def test_the_sum_has_the_clock_of_who_takes_it(robot: Scene) -> None:
    """One slave more, whose terms are named after their slaves; no slave more for one feedforward alone."""
    slow = {**PD, "sample_time": 3e-3, "offset": 1e-3}
    *_, total = loop_of(robot.replace({"controller": [GRAVITY, slow, FRICTION]})).controllers
    assert (total.name, total.sample_time, total.offset) == ("feedforward_sum", 3e-3, 1e-3)  # type: ignore[attr-defined]
    inputs = [each.name for each in total.variables if each.causality == "input"]
    assert inputs[:2] == ["gravity_feedforward.joint1.feedforward", "friction_compensation.joint1.feedforward"]
    assert len(loop_of(robot.replace({"controller": [GRAVITY, PD]})).controllers) == 2


def test_explicit_connections_come_first(robot: Scene) -> None:
    """Who names one of both gets that one."""
    chosen = {f"joint{i}.feedforward": f"gravity_feedforward.joint{i}.feedforward" for i in (1, 2)}
    scene = robot.replace({"controller": [GRAVITY, {**PD, "connect": chosen}, FRICTION], "trajectory.dwell": 0.0})
    assert "gravity_feedforward.joint1.feedforward -> pd.joint1.feedforward" in connections(run_scene(scene))
    assert len(loop_of(scene).controllers) == 3


def test_no_common_instants(robot: Scene) -> None:
    """Two controllers at different instants can't share a sum."""
    second = {**PD, "name": "second", "sample_time": 2e-3}
    with pytest.raises(
        WiringError,
        match=r"pd, second, which take the sum, aren't sampled at the same instants: give them one sample_time",
    ):
        loop_of(robot.replace({"controller": [GRAVITY, PD, FRICTION, second]}))


def test_what_counts_twice_is_told(robot: Scene) -> None:
    """The rigid torques have gravity and friction in them; without either in the scene nothing counts twice."""
    whole = {"kind": "feedforward", "sample_time": 1e-3}
    both = robot.replace({"controller": [PD, whole, GRAVITY, FRICTION], "effects.joint_friction.viscous": 1.0})
    gravity, friction = counted_twice(both)
    assert gravity.startswith("gravity counts twice: `feedforward` has it, and so does `gravity-feedforward`")
    assert friction.startswith("friction counts twice")
    assert counted_twice(both.replace({"effects.gravity": [0.0, 0.0], "effects.joint_friction.viscous": 0.0})) == []
    assert counted_twice(robot.replace({"controller": [PD, GRAVITY, FRICTION]})) == []


SAMPLE = 1e-3


def driven(robot: Scene, derivative: float, **others: Any) -> Run:
    """The robot with a PD controller."""
    pd = {"kind": "pd", "proportional": 1e4, "derivative": derivative, "sample_time": SAMPLE}
    return run_scene(robot.replace({"controller": [pd], "trajectory.dwell": 0.25, **others}))


def largest_multiplier(robot: Scene, derivative: float) -> float:
    """Largest magnitude of an eigenvalue of the linearised loop, from sample to sample."""
    outputs = [f"joint{joint}.{kind}" for kind in ("position", "velocity") for joint in (1, 2)]
    plant = linearize(robot, robot.trajectory.start, outputs=outputs)
    a, b, c, *_ = cont2discrete((plant.A, plant.B[:, :2], plant.C, plant.D[:, :2]), SAMPLE)
    gains = np.hstack([1e4 * np.eye(2), derivative * np.eye(2)])
    return float(abs(np.linalg.eigvals(a - b @ gains @ c)).max())


@pytest.mark.parametrize("derivative", [600.0, 1000.0])
def test_growth_is_that_of_the_linearised_loop(robot: Scene, derivative: float) -> None:
    """A gain that is too high: the run fails where the mechanism no longer assembles, and the growth per sample that the message
    states is the loop's largest multiplier. A warning says so from Python too."""
    with pytest.warns(LoopWarning, match="the control loop is unstable"):
        run = driven(robot, derivative)
    assert run.health.unstable_loop == run.health.messages[0]
    assert run.outcome in (Outcome.LOOP_UNSTABLE, Outcome.COUPLING_UNSTABLE)
    assert "unstable" in run.message.partition("in the end plant failed")[0]
    sentence = divergence(run) or ""
    stated = float(sentence.partition("error grows ")[2].partition("-fold")[0])
    assert stated == pytest.approx(largest_multiplier(robot, derivative), rel=0.1)
    assert stated > 1.5


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
@pytest.mark.parametrize(("changes", "remedy"), [
    ({"imperfection": [{"kind": "delay", "signal": "torque", "time": 0.02}]},
     r"shorten the delays \(0.02\d* s of delay.joint\d.torque -> plant.joint\d.torque\)"),
    ({"effects.motor_inertia": 0.0}, r"give the motors their inertia \(`effects.motor_inertia`\)"),
], ids=["delay", "no motor inertia"])  # fmt: skip
def test_remedies_are_those_of_the_cause(robot: Scene, changes: dict[str, Any], remedy: str) -> None:
    """Neither a singularity nor the assembly is blamed first, and what the scene has done wrong is named."""
    run = driven(robot, 100.0, **changes)
    assert run.outcome is Outcome.LOOP_UNSTABLE
    cause, _, end = run.message.partition("in the end ")
    assert "off its reference" in cause
    assert "singular" not in cause
    assert "plant failed" in end
    assert re.search(remedy, cause), cause


def test_slow_divergence_is_warned_of(robot: Scene) -> None:
    """Without damping the joints' velocities grow while the references rest; the run reaches its end, and its health says so, also
    where velocities aren't recorded; a warning says it at the line that calls flexfmu."""
    with pytest.warns(LoopWarning, match="the control loop is unstable") as caught:
        run = driven(robot, 0.0, **{"cosimulation.record": ["end_effector.position.x"]})
    assert run.completed
    assert list(run.recording.columns) == ["end_effector.position.x"]
    message = str(caught[0].message)
    assert caught[0].filename == __file__
    assert run.health.messages[0] == run.health.unstable_loop == message
    health = summarise(run, {})["health"]
    assert health["unstable_loop"] == message


def test_the_command_line_says_it_once(tmp_path: Path) -> None:
    """The summary has the sentence, and no warning of Python beside it."""
    settings = (
        'cosimulation.drive="torque"',
        "effects.motor_inertia=0.1",
        'controller=[{kind="pd",proportional=1e4,derivative=0.0,sample_time=1e-3}]',
    )
    options = [word for setting in settings for word in ("--set", setting)]
    words = ["run", "barnard2012-6kg", "--no-verify", "--no-report", "--out", str(tmp_path), *options]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert (result.stdout.count("off its reference"), result.stderr.count("off its reference")) == (1, 0)


def test_stable_loops_are_left_alone(robot: Scene) -> None:
    """Neither a good controller nor one that lets the arm fall until it catches it is called unstable, at any speed."""
    for changes in ({}, {"trajectory.duration": 2.0, "trajectory.dwell": 0.1, "cosimulation.step": 1e-3}):
        run = driven(robot, 100.0, **changes)
        assert run.completed
        assert run.health.unstable_loop is None
        assert run.health.messages == ()
