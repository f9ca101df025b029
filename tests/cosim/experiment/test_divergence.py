"""Control loops that are unstable are called so, whatever ends their runs, and no others."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import cont2discrete
from typer.testing import CliRunner

from flexfmu.cosim.cli.main import app
from flexfmu.cosim.engine.errors import LoopWarning
from flexfmu.cosim.engine.master.simulator import Outcome
from flexfmu.cosim.experiment.run_checks import divergence
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.reports.summary import summarise
from flexfmu.model.linear import linearize
from flexfmu.model.scene.schema import Scene

SAMPLE = 1e-3


def controlled(robot: Scene, derivative: float, **others: Any) -> Run:
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
        run = controlled(robot, derivative)
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
    run = controlled(robot, 100.0, **changes)
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
        run = controlled(robot, 0.0, **{"cosimulation.record": ["end_effector.position.x"]})
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
        run = controlled(robot, 100.0, **changes)
        assert run.completed
        assert run.health.unstable_loop is None
        assert run.health.messages == ()
