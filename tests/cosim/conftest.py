"""A run in memory, without FMU and compiler: the rigid motion plus a vibration, static deflection included."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from foreign_fmu import maker

from flexfmu.cosim.engine.master.simulator import Outcome
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.cosim.experiment.scene_run import Health, Run, Timing
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium

MakeRun = Callable[..., Run]


def two_sided_times(motion_plan: MotionPlan, step: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Instants up to ``end``, breakpoints twice, and whether each is a left limit."""
    duration, stop = motion_plan.duration, motion_plan.stop_time
    grid = np.union1d(np.arange(0.0, stop, step), [*motion_plan.task.breakpoints, stop])
    grid = grid[np.concatenate([[True], np.diff(grid) > 1e-9])]
    doubled = np.isclose(grid[:, np.newaxis], motion_plan.task.breakpoints, rtol=0.0, atol=1e-12).any(axis=1)
    time = np.repeat(grid, 1 + doubled)
    is_left = np.zeros(len(time), dtype=bool)
    is_left[:-1] = time[:-1] == time[1:]
    kept = time <= min(end, stop)
    assert duration <= stop
    return time[kept], is_left[kept]


def record(motion_plan: MotionPlan, step: float, end: float) -> Recording:
    """A recording with all signals of the motion-driven plant, vibrating at 58 Hz with 14 % damping after T."""
    time, is_left = two_sided_times(motion_plan, step, end)
    evaluate = [
        np.where(is_left[:, np.newaxis], trajectory.evaluate(time, 4, "left"), trajectory.evaluate(time, 4, "right"))
        for trajectory in (motion_plan.task, motion_plan.joints)
    ]
    task, joints = evaluate
    end_joints = motion_plan.joints.evaluate(motion_plan.duration, 0, "left")[0, 0]
    deflection = (
        static_equilibrium(motion_plan.scene, end_joints).position
        - motion_plan.task.evaluate(motion_plan.duration, 0)[0, 0]
    )
    root = complex(-50.0, 2 * math.pi * 58.0)
    ringing = np.stack(
        [np.imag(2e-4 * root**k * np.exp(root * (time - motion_plan.duration)) * (time > 0)) for k in range(5)]
    )
    after = (time > motion_plan.duration) | ((time == motion_plan.duration) & ~is_left)
    task = task + ringing[:, :, np.newaxis] * after[:, np.newaxis]
    task[0] += deflection
    columns: dict[str, Column] = {}
    for axis, name in enumerate("xy"):
        for order, kind in enumerate(("position", "velocity", "acceleration")):
            columns[f"end_effector.{kind}.{name}"] = Column("m", *task[order : order + 3, :, axis])
    for joint in (1, 2):
        for order, kind in enumerate(("position", "velocity", "acceleration")):
            columns[f"joint{joint}.reference.{kind}"] = Column("rad", *joints[order : order + 3, :, joint - 1])
        columns[f"joint{joint}.torque"] = Column("N.m", *joints[2:5, :, joint - 1])
    for name in ("link11.tip_deflection", "link21.tip_deflection", "link11.bending[1]"):
        columns[name] = Column("m", *(1e-3 * ringing[:3] / 2e-4 * after))
    return Recording(time, columns)


@pytest.fixture(scope="session")
def make_decay(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Makes a plain FMU of another tool's kind, x' = rate (u - x), its description changed: make_decay(("m", "mm"))."""
    return maker(tmp_path_factory.mktemp("foreign"), "decay", "modelDescription.xml")


@pytest.fixture(scope="session")
def make_run() -> MakeRun:
    """A function that makes a run: make_run(step=2e-4, outcome=Outcome.COMPLETED, end=inf, changes={})."""

    def make(
        step: float = 1e-3,
        outcome: Outcome = Outcome.COMPLETED,
        end: float = math.inf,
        changes: dict[str, object] | None = None,
    ) -> Run:
        motion_plan = plan(load_scene("barnard2012-6kg").replace(changes or {}))
        return Run(
            plan=motion_plan,
            recording=record(motion_plan, step, end),
            outcome=outcome,
            message="all went well" if outcome is Outcome.COMPLETED else "step failed at 0.2 s",
            fmu_path=Path("nowhere.fmu"),
            communication_step=step,
            tolerance=1e-6,
            input_order=9,
            health=Health({"steps": 1234, "rejections": 5}, ()),
            timing=Timing(plan=0.1, build=0.2, load=0.05, simulate=0.02),
            measure=measure_run,
        )

    return make


@pytest.fixture(scope="session")
def robot() -> Scene:
    """The paper's robot, driven by torques. Without motor inertia the joints of flexible links are next to massless at high frequency,
    and no velocity feedback of useful strength is stable at 1 kHz."""
    return load_scene("barnard2012-6kg").replace(
        {"name": "loop", "cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "trajectory.dwell": 0.1}
    )


@pytest.fixture(scope="session")
def controlled(robot: Scene) -> Scene:
    """The same with a computed-torque controller at 1 kHz."""
    law = {"kind": "computed-torque", "proportional": 6400.0, "derivative": 160.0, "sample_time": 1e-3}
    return robot.replace({"controller": [law]})
