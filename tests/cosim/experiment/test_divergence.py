"""Control loops that are unstable are called so, whatever ends their runs, and no others."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from scipy.signal import cont2discrete

from flexfmu.cosim.engine.master.master import Outcome
from flexfmu.cosim.experiment.divergence import divergence
from flexfmu.cosim.experiment.prepared_scene import Run, run_scene
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
    states is the loop's largest multiplier."""
    run = controlled(robot, derivative)
    assert run.outcome in (Outcome.LOOP_UNSTABLE, Outcome.COUPLING_UNSTABLE)
    assert "unstable" in run.message.partition("in the end plant failed")[0]
    sentence = divergence(run) or ""
    stated = float(sentence.partition("error grows ")[2].partition("-fold")[0])
    assert stated == pytest.approx(largest_multiplier(robot, derivative), rel=0.1)
    assert stated > 1.5


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        (
            {"imperfection": [{"kind": "delay", "signal": "torque", "time": 0.02}]},
            r"shorten the delays \(0.02\d* s of delay.joint\d.torque -> plant.joint\d.torque\)",
        ),
        ({"effects.motor_inertia": 0.0}, r"give the motors their inertia \(`effects.motor_inertia`\)"),
    ],
    ids=["delay", "no motor inertia"],
)
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
    """Without damping the joints' velocities grow while the references rest; the run reaches its end, and its health says so."""
    run = controlled(robot, 0.0)
    assert run.completed
    health = summarise(run, {})["health"]
    assert "the control loop is unstable" in health["unstable_loop"]


def test_stable_loops_are_left_alone(robot: Scene) -> None:
    """Neither a good controller nor one that lets the arm fall until it catches it is called unstable, at any speed."""
    for changes in ({}, {"trajectory.duration": 2.0, "trajectory.dwell": 0.1, "cosimulation.step": 1e-3}):
        run = controlled(robot, 100.0, **changes)
        assert run.completed
        assert divergence(run) is None
