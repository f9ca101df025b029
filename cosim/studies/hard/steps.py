"""Communication steps of extreme length, references that jump between steps, and a controller whose gain is too high for its step.

The references are constant over each step, so that SciPy solves the same piecewise constant problem, restarted at every jump.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.prepared_scene import PreparedScene
from flexfmu.cosim.studies.hard.case import (
    ALLOWED,
    ERROR,
    NOT_FINITE,
    STEP,
    TOLERANCE,
    CaseReport,
    Criterion,
    HardCase,
    fmu_of,
    not_finite,
    paper_robot,
)
from flexfmu.cosim.studies.hard.scipy_solution import Phase, Solver, signals_of_constant_references
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.schema import Scene

SIGNALS = ("end_effector.position.x", "end_effector.position.y", "link11.tip_deflection", "link21.tip_deflection")
"""Outputs that are compared; all lengths [m]."""

REFERENCES = tuple(
    f"joint{leg}.reference.{kind}" for kind in ("position", "velocity", "acceleration") for leg in (1, 2)
)
"""Inputs, in the order of u = [q_a, v_a, a_a]."""

SOLVER = Solver("DOP853", 1e-10)


DAMPING = 0.01
"""Modal damping ratio of the links, small so that vibrations last."""


@dataclass(frozen=True)
class StepwiseRun:
    """The paper's robot, little damped, from links that are straight and at rest.

    Attributes:
        times: (N + 1,) communication points [s]; the first is 0.
        references: (N, 6) u over each step.
    """

    times: RealArray
    references: RealArray

    def outputs(self) -> RealArray:
        """(N, signals) of the FMU at the ends of the steps.

        Raises:
            SlaveError: the FMU fails.
        """
        plant = FmuSlave(fmu_of(paper_robot()), "plant", {"initial": "undeformed", "damping.ratio": DAMPING})
        known = [variable.name for variable in plant.variables]
        inputs, outputs = (
            np.array([known.index(name) for name in names], dtype=np.intp) for names in (REFERENCES, SIGNALS)
        )
        found = np.empty((self.times.size - 1, outputs.size))
        # inputs of the first step hold during initialisation
        plant.set(inputs, self.references[0])
        try:
            plant.initialize(0.0, float(self.times[-1]), TOLERANCE)
            for n, (begin, end) in enumerate(pairwise(self.times.tolist())):
                plant.set(inputs, self.references[n])
                plant.step(begin, end - begin)
                plant.get(outputs, found[n])
        finally:
            plant.terminate()
        return found

    def reference(self, size: float) -> RealArray:
        """(N, signals) by SciPy; ``size`` is about how far links deflect [m]."""
        damped = paper_robot().replace({"effects.damping.ratio": DAMPING})
        # intervals of constant references; each instant belongs to the one that ends there
        changes = np.flatnonzero(np.any(np.diff(self.references, axis=0) != 0.0, axis=1)) + 1
        edges = [0, *changes.tolist(), self.times.size - 1]
        phases = [Phase(float(self.times[a]), float(self.times[b]), self.references[a]) for a, b in pairwise(edges)]
        return signals_of_constant_references(paper_robot(), damped, phases, SIGNALS, self.times[1:], SOLVER, size)


def start_references() -> RealArray:
    """u (6,) of the paper's start pose, locked."""
    robot = paper_robot()
    return np.concatenate([motor_angles(robot.mechanism, robot.start), np.zeros(4)])


TINY, TINY_STEPS = 1e-9, 10_000
"""Length [s] and number of the shortest steps."""

JUMP = 0.02
"""Jump of the joint angles [rad], physically impossible for a motor."""

ACCELERATION = 200.0
"""Joint acceleration [rad/s2], switched on and off."""


def step_cases() -> Iterator[HardCase]:
    """Steps of 1 ns and 1 s, and references that jump."""
    tiny = f"{TINY_STEPS} steps: links bend by 0.5 nm; 1 ns is 2e-5 of the shortest period"
    huge = "18 800 periods of the fastest mode in one communication step"
    jumps = f"joint angles jump by {1e3 * JUMP:g} mrad, accelerations by {ACCELERATION:g} rad/s2, in steps of 1 ms without input derivatives"
    yield HardCase("steps of 1 ns", tiny, partial(_run_stepwise, tiny_steps))
    yield HardCase("a step of 1 s", huge, partial(_run_stepwise, huge_step))
    yield HardCase("inputs that jump", jumps, partial(_run_stepwise, jumping_inputs))


def tiny_steps() -> StepwiseRun:
    """Straight links begin to bend under the weight."""
    times = TINY * np.arange(TINY_STEPS + 1, dtype=np.float64)
    return StepwiseRun(times, np.tile(start_references(), (TINY_STEPS, 1)))


def huge_step() -> StepwiseRun:
    """Free vibration under the weight."""
    return StepwiseRun(np.array([0.0, 1.0]), start_references()[np.newaxis])


def jumping_inputs() -> StepwiseRun:
    """Angles jump forth and back, then accelerations, in steps of 1 ms."""
    references = np.tile(start_references(), (60, 1))
    references[10:30, :2] += JUMP, -JUMP
    references[20:40, 4:] += ACCELERATION, -ACCELERATION
    return StepwiseRun(1e-3 * np.arange(61, dtype=np.float64), references)


def _run_stepwise(make: Callable[[], StepwiseRun]) -> CaseReport:
    """Against SciPy, each signal relative to its own range."""
    run = make()
    # the FMU, and SciPy with an absolute tolerance that follows from the deflections
    found = run.outputs()
    size = float(np.abs(found[:, 2:]).max())
    expected = run.reference(size)
    # deflections relative to their own range, the end effector relative to the deflections
    error = float((np.abs(found - expected)[:, 2:].max(axis=0) / np.abs(expected[:, 2:]).max(axis=0)).max())
    position = float(np.abs(found - expected)[:, :2].max()) / size
    bent = f"steps completed: {len(found)}; links bend by up to {size:.2g} m"
    checks = (
        Criterion(f"{ERROR} (DOP853)", error, ALLOWED),
        Criterion("error of the end effector", position, ALLOWED),
        Criterion(NOT_FINITE, float(np.count_nonzero(~np.isfinite(found))), 0.0),
    )
    return CaseReport(bent, checks)


INERTIA = 0.1
"""Inertia of each motor [kg.m2]."""

PROPORTIONAL, DERIVATIVE = 1e4, 300.0
"""Gains of the PD controller [N.m/rad], [N.m.s/rad]."""

SHORT_STEP = 1e-4
"""Step and sample time [s] at which the loop with the same gains is stable."""

STABILITY_STEPS = (STEP, SHORT_STEP)

TRACKING = 0.05
"""Limit of the tracking error [rad] of a stable loop: a tenth of the joints' motion."""

NAMED = ("unstable", "plant", "pd", " s: ")
"""Parts of the message: the failure, the slaves, the time."""


def gain_cases() -> Iterator[HardCase]:
    """One case: a PD controller whose gain is too high."""
    overshoot = DERIVATIVE * STEP / INERTIA
    hard = f"a velocity error is over-corrected {overshoot:.0f}-fold in every step of {1e3 * STEP:g} ms"
    yield HardCase("gain too high, coupled by Jacobi", hard, _unstable)


def controlled_robot(step: float) -> Scene:
    """Robot with motors and PD controller, side by side."""
    controller = {"kind": "pd", "proportional": PROPORTIONAL, "derivative": DERIVATIVE, "sample_time": step}
    return paper_robot().replace(
        {
            "cosimulation.drive": "torque",
            "cosimulation.algorithm": "jacobi",
            "cosimulation.step": step,
            "effects.motor_inertia": INERTIA,
            "effects.proximal_bending": 1,
            "effects.distal_axial": 1,
            "controller": [controller],
        }
    )


def _unstable() -> CaseReport:
    """The run reports an unstable coupling, and is stable with the shorter step that the message recommends."""
    run, cured = (
        PreparedScene(controlled_robot(step), fmu_path=fmu_of(controlled_robot(STEP))).run() for step in STABILITY_STEPS
    )
    unnamed = sum(part not in run.message for part in NAMED)
    # largest tracking error of the joints with the short step [rad]; NaN for a run that didn't reach its end
    tracking = float("nan")
    if cured.completed:
        names = ((f"joint{leg}.position", f"joint{leg}.reference.position") for leg in (1, 2))
        errors = (np.abs(cured.recording[a].values - cured.recording[b].values).max() for a, b in names)
        tracking = max(float(error) for error in errors)
    checks = (
        Criterion("outcomes other than an unstable coupling", float(run.outcome is not Outcome.COUPLING_UNSTABLE), 0.0),
        Criterion("slaves or time not named", float(unnamed), 0.0),
        not_finite(run.recording),
        Criterion(f"tracking error in steps of {1e3 * SHORT_STEP:g} ms", tracking, TRACKING, "rad"),
    )
    return CaseReport(run.message, checks)
