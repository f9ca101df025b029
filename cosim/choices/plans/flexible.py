"""Candidates with references for the flexible robot: on the given path, and on the paths that the search found.

The end effector of the flexible robot stays on its path, so a path that keeps clear of everything stays clear, and no time goes
into a shaper. A correction makes the references hold over the bands of payload, stiffness and damping.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from flexfmu.cosim.choices.plans.assessment import Assessment, Candidate, Judge
from flexfmu.cosim.choices.plans.goals import Goals, Variation
from flexfmu.cosim.experiment.planning import MotionPlan, plan_rigid
from flexfmu.model.reference_design.inverse_dynamics import LEAD, FlexibleReferences, flexible_references
from flexfmu.model.reference_design.robust_correction import Tolerances, corrected
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray

Show = Callable[[str, float | None], None]

PAYLOADS = 16
"""Payloads of the correction: fewer are overfitted."""

PATHS = 2
"""Number of the search's paths that are tried: each takes a few seconds."""

KEPT = 0.99
"""Share of each limit that is used: the correction meets limits to half a percent, and the given torques vary between payloads."""

TRIALS = 4
"""Largest number of durations that are tried for a path."""


def flexible(goals: Goals, found: Sequence[Assessment], processes: int, show: Show) -> Iterator[Candidate]:
    """Yield motions with references for the flexible robot.

    Args:
        goals: what to reach.
        found: the given motion, and what else was assessed.
        processes: not used: a correction takes a few seconds.
        show: is called with what is being done.

    Raises:
        TrajectoryError: no such references exist, on any path.
    """
    # the given motion's torques for each payload of the correction
    given = Judge(goals, PAYLOADS).given
    bases = [("the given path", _bare(goals.scene), goals.given.once.duration)]
    bases += [(each.candidate.label, _bare(each.candidate.scene), each.time) for each in _paths(found)]
    for i, (label, scene, time) in enumerate(bases):
        show(f"references for the flexible robot on {label}", i / len(bases))
        try:
            motion, design = _in_time(goals, given, scene, time, shorten=i > 0)
            yield _candidate(goals, given, f"flexible references on {label}", motion, design)
        except TrajectoryError:
            # the error of the given path tells what is wrong; those of others may be their own
            if i == 0 and len(bases) == 1:
                raise


def _bare(scene: Scene) -> Scene:
    """The scene with its path alone."""
    changes: dict[str, Any] = {"shaper": [], "trajectory.references": None}
    changes |= (
        {}
        if scene.trajectory.way_back == "none"
        else {"trajectory.way_back": "none", "trajectory.cycles": 1, "trajectory.pause": 0.0}
    )
    return scene.replace(changes)


def _paths(found: Sequence[Assessment]) -> list[Assessment]:
    """The fastest motions along paths of their own that keep to all limits but residual and torque, which change here."""
    able = [
        each
        for each in found[1:]
        if each.candidate.trajectory is None
        and isinstance(each.candidate.scene.trajectory, TrajectorySection)
        and all(use.met or use.name in ("residual", "torque ratio", "torque") for use in each.uses)
    ]
    able.sort(key=lambda each: (not each.feasible, each.time))
    kept: list[Assessment] = []
    for each in able:
        shapes = [other.candidate.scene.trajectory for other in kept]
        if not any(_same_path(each.candidate.scene.trajectory, other) for other in shapes):
            kept.append(each)
    return kept[:PATHS]


def _same_path(one: object, other: object) -> bool:
    """Whether two pick-and-place motions have the same path."""
    assert isinstance(one, TrajectorySection)
    assert isinstance(other, TrajectorySection)
    return (one.blend, one.height, one.profile) == (other.blend, other.height, other.profile)


def _in_time(
    goals: Goals, given: Assessment, scene: Scene, time: float, *, shorten: bool
) -> tuple[MotionPlan, FlexibleReferences]:
    """The rigid robot's motion and the references in a time [s]; or in the shortest one, as the torque falls with its square."""
    share = 0.0
    for _ in range(TRIALS if shorten else 1):
        motion = plan_rigid(scene.replace({"trajectory.duration": time - 2.0 * LEAD}))
        design = flexible_references(scene, motion.task, motion.joints)
        share = _share(goals, given, design)
        if 0.97 < share <= KEPT:
            break
        time *= float(np.sqrt(share / 0.98))
    return motion, design


def _share(goals: Goals, given: Assessment, design: FlexibleReferences) -> float:
    """The largest share of the limits of torque, speed, acceleration and jerk that references take, as squares of a speed."""
    fractions = np.linspace(0.0, 1.0, 8 * design.motors.intervals + 1)
    peaks = np.abs(design.motors.evaluate(fractions, 3)).max(axis=(1, 2))
    shares = []
    for k, name in ((1, "speed"), (2, "acceleration"), (3, "jerk")):
        bound = _bound(goals, name, given.references[k - 1])
        shares.append(0.0 if bound is None else float(peaks[k] / bound) ** (2.0 / k))
    limit = _torques(goals, given, [Variation(goals.scene.payload.mass)])
    if limit is not None:
        torque = np.abs(design.torque(fractions * design.motors.duration)).max(axis=0)
        shares.append(KEPT * float((torque / limit[0]).max()))
    return max(shares)


def _candidate(
    goals: Goals, given: Assessment, label: str, motion: MotionPlan, design: FlexibleReferences
) -> Candidate:
    """The motion with references that hold over the bands."""
    variations = goals.variations(PAYLOADS)
    jerk = _bound(goals, "jerk", given.references[2])
    tolerances = Tolerances(
        residual=0.2 * goals.wishes.residual,
        off_path=0.9 * goals.wishes.margin,
        torque=_torques(goals, given, variations),
        jerk=None if jerk is None else KEPT * jerk,
    )
    changes = [each.changes(goals.scene) for each in variations]
    try:
        motors = corrected(motion.scene, changes, design.motors, motion.task, tolerances).motors
    except TrajectoryError:
        # the FMU judges whether they do without a correction
        motors, label = design.motors, f"{label}, for the nominal payload"
    return Candidate(label, "flexible references", _bare(goals.scene), motors.trajectory())


def _bound(goals: Goals, name: str, usual: float) -> float | None:
    """A limit in its unit; None if there is none."""
    limit = goals.limits.get(name)
    if limit is None:
        return None
    return limit.value if limit.ratio is None else limit.ratio * usual


def _torques(goals: Goals, given: Assessment, variations: Sequence[Variation]) -> RealArray | None:
    """Largest torques (variations, 2) [N m] that are used; None without a limit."""
    limit = goals.limits.get("torque")
    if limit is None:
        return None
    if limit.ratio is None:
        return np.full((len(variations), 2), KEPT * (limit.value or 0.0))
    # relative to the given motion's, which was assessed with these robots
    usual = {each.variation: each.torque for each in given.peaks}
    nominal = min(usual, key=lambda each: abs(each.payload - goals.scene.payload.mass))
    return KEPT * limit.ratio * np.array([usual.get(each, usual[nominal]) for each in variations])
