"""Towards the type-2 singularity, in which the distal links lie in one line and the motors lose control of the payload
(Gosselin and Angeles, IEEE Trans. Robot. Autom. 6, 1990). A run must either meet the reference or stop and say where and why.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from math import sqrt

import numpy as np

from flexfmu.benchmarks.hard_cases.case import (
    ALLOWED,
    CaseReport,
    Criterion,
    HardCase,
    error_against,
    loop_geometry,
    not_finite,
    off_branch,
    paper_robot,
    run_case,
    soundness,
)
from flexfmu.benchmarks.hard_cases.scipy_solution import Solver
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.plants import MINIMUM_SINE
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import Jet
from flexfmu.trajectories.joint import InverseKinematics, JointTrajectory, Margin
from flexfmu.trajectories.piecewise import PiecewisePolynomial

PROFILE = np.array([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
"""Fraction of the way as a polynomial of that of the duration: rates, accelerations and jerks vanish at both ends."""


def rest_to_rest(start: tuple[float, float], end: tuple[float, float], duration: float) -> PiecewisePolynomial:
    """A straight motion from x and y [m] to others in a time [s]."""
    coefficients = np.multiply.outer(PROFILE / duration ** np.arange(PROFILE.size), [np.subtract(end, start)])
    coefficients[0] += start
    return PiecewisePolynomial(np.array([0.0, duration]), coefficients)


@dataclass(frozen=True)
class Unguarded:
    """Inverse kinematics without the planner's safety margins."""

    kinematics: RigidKinematics

    def joints(self, x: Jet, y: Jet) -> tuple[Jet, Jet]:
        """Return the joints of ``kinematics``."""
        return self.kinematics.joints(x, y)

    def margins(self, position: RealArray) -> tuple[Margin, ...]:
        """Return no margins."""
        return ()


def straight_motion(
    base: MotionPlan,
    scene: Scene,
    line: PiecewisePolynomial,
    guard: Callable[[RigidKinematics], InverseKinematics] = lambda kinematics: kinematics,
) -> MotionPlan:
    """A plan with the line in place of the scene's path.

    Args:
        base: a plan; what has to do with its path is replaced.
        scene: whose mechanism moves.
        line: the motion.
        guard: what to make of the inverse kinematics, for example `Unguarded`.

    Raises:
        TrajectoryError: the line leaves the workspace or comes too near to a singularity.
    """
    kinematics = RigidKinematics(scene.mechanism)
    joints = JointTrajectory(line, guard(kinematics))
    return replace(base, scene=scene, kinematics=kinematics, task=line, joints=joints)


START = (0.02, -0.14)
"""Where the motion starts [m]: the end effector hangs below the elbows, off the middle, so that its stop makes it swing."""

DURATION, DWELL = 0.3, 0.2

REFERENCE = Solver("DOP853", 1e-10)

NAMED = ("end_effector.position.x", "end_effector.position.y", "type-2 singularity", " s the ")
"""Parts of a stopped run's message: pose, measure, time."""

HALF_DISTANCES = (100, 20, 5, 1)
"""Of the elbows at the end of the motion [mm]."""


def cases() -> Iterator[HardCase]:
    """One for each half-distance."""
    for half in HALF_DISTANCES:
        ratio = 1e-3 * half / paper_robot().mechanism.distal.length
        sine = 2.0 * ratio * sqrt(1.0 - ratio**2)
        hard = f"distal links cross at a sine of {sine:.2g} at the end of the motion; 6 kg swing there"
        yield HardCase(f"elbows {half} mm from the middle", hard, partial(_approach, 1e-3 * half))


@lru_cache(maxsize=1)
def hanging_robot() -> Scene:
    """The paper's robot with the end effector below its elbows."""
    return paper_robot().replace(
        {
            "mechanism.assembly_mode": "right",
            "trajectory.start": START,
            "trajectory.duration": DURATION,
            "trajectory.dwell": DWELL,
        }
    )


def pose(mechanism: Mechanism, half_distance: float) -> tuple[float, float]:
    """Where the end effector hangs [m] in the middle with the elbows so far from it on both sides [m]."""
    across = mechanism.base_half_distance - half_distance
    elbow = sqrt(mechanism.proximal.length**2 - across**2)
    return 0.0, elbow - sqrt(mechanism.distal.length**2 - half_distance**2)


def motion_to(half_distance: float, guarded: bool) -> MotionPlan:
    """From `START` straight to the pose.

    Raises:
        TrajectoryError: the planner keeps away from it.
    """
    robot = hanging_robot()
    line = rest_to_rest(START, pose(robot.mechanism, half_distance), DURATION)
    keep = (lambda kinematics: kinematics) if guarded else Unguarded
    return straight_motion(plan(paper_robot()), robot, line, keep)


def approach(half_distance: float) -> Run:
    """Simulate the motion even if the planner rejects it."""
    return run_case(hanging_robot(), motion=motion_to(half_distance, guarded=False))


def _approach(half_distance: float) -> CaseReport:
    """A finished run is compared with SciPy's; a stopped one must name pose, measure and time."""
    run = approach(half_distance)
    happened = run.message
    # the planner's refusal belongs to the report
    try:
        motion_to(half_distance, guarded=True)
    except TrajectoryError as refusal:
        happened = f"the planner refuses: {refusal}. Run nevertheless: {happened}"
    if run.completed:
        return CaseReport(happened, (error_against(run, hanging_robot(), REFERENCE, ALLOWED), *soundness(run)))
    # a stopped run stays on its branch and names what stopped it
    geometry = loop_geometry(run.scene.mechanism, run.recording)
    unnamed = sum(part not in run.message for part in NAMED)
    checks = (
        Criterion("outcomes other than a failed step", float(run.outcome is not Outcome.STEP_FAILED), 0.0),
        Criterion("pose, measure or time not named", float(unnamed), 0.0),
        Criterion("least sine overrun", max(0.0, MINIMUM_SINE - float(geometry.sine.min())), 0.0),
        not_finite(run.recording),
        off_branch(geometry.sine),
    )
    return CaseReport(happened, checks)
