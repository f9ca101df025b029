"""A candidate with references for the flexible robot on the given path, in the given time.

The end effector of the flexible robot stays on the path. A correction makes the references hold over the bands of payload,
stiffness and damping.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge
from flexfmu.cosim.design.plans.goals import Goals
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.showing import ShowProgress
from flexfmu.cosim.experiment.planning import plan_rigid
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.model.reference_design.inverse_dynamics import LEAD, flexible_references
from flexfmu.model.reference_design.joint_spline import JointSpline
from flexfmu.model.reference_design.robust_correction import Tolerances, corrected
from flexfmu.model.scene.motion import TableSection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError

PAYLOADS = 16
"""Payloads of the correction: fewer are overfitted."""

KEPT = 0.99
"""Share of each limit that is used: the correction meets limits to half a percent, and the given torques vary between payloads."""


Kept = tuple[list[tuple[float, float]], float, int, str]
"""What a journal has of references: the spline's coefficients, duration and degree, and what follows the label."""


def flexible(
    goals: Goals, found: Sequence[Assessment], processes: int, show: ShowProgress, journal: WorkJournal = NOWHERE
) -> Iterator[Candidate]:
    """Yield motions with references for the flexible robot.

    Args:
        goals: what to reach.
        found: the given motion, and what else was assessed.
        processes: not used: a correction takes a few seconds.
        show: is called with what is being done.
        journal: where the references are kept.

    Raises:
        InputError: the given motion is a table.
        TrajectoryError: there are no such references.
    """
    if isinstance(goals.scene.trajectory, TableSection):
        raise InputError(
            f"scene {goals.scene.name} has a motion from a table, and references for the flexible robot follow a path"
        )
    # the path alone
    bare: dict[str, Any] = {"shaper": [], "trajectory.references": None}
    if goals.scene.trajectory.way_back != "none":
        bare |= {"trajectory.way_back": "none", "trajectory.cycles": 1, "trajectory.pause": 0.0}
    scene = goals.scene.replace(bare)
    show("references for the flexible robot on the given path", None)
    coefficients, duration, degree, note = journal.kept(("flexible",), Kept, lambda: _references(goals, scene))
    motors = JointSpline(np.array(coefficients), duration, degree)
    label = f"flexible references on the given path{note}"
    yield Candidate(label, "flexible references", scene, motors.trajectory())


def _references(goals: Goals, scene: Scene) -> tuple[Any, ...]:
    """References for the scene of the path alone, as a journal has them."""
    # the given motion's torques for each payload of the correction
    given, variations = Judge(goals, PAYLOADS).given, goals.variations(PAYLOADS)
    usual = {each.variation: each.torque for each in given.peaks}
    nominal = min(usual, key=lambda each: abs(each.payload - goals.scene.payload.mass))
    torques = np.array([usual.get(each, usual[nominal]) for each in variations])
    motion = plan_rigid(scene.replace({"trajectory.duration": goals.given.once.duration - 2.0 * LEAD}))
    motors = flexible_references(scene, motion.task, motion.joints).motors
    # references that hold over the bands
    tolerances = Tolerances(
        residual=0.2 * goals.wishes.residual,
        off_path=0.9 * goals.wishes.margin,
        torque=KEPT * goals.limit("torque", torques) if "torque" in goals.limits else None,
        jerk=KEPT * float(goals.limit("jerk", np.array(given.references[2]))) if "jerk" in goals.limits else None,
    )
    try:
        changes = [each.changes(goals.scene) for each in variations]
        return *vars(corrected(motion.scene, changes, motors, motion.task, tolerances)).values(), ""
    except TrajectoryError:
        # the FMU judges whether they do without a correction
        return *vars(motors).values(), ", for the nominal payload"
