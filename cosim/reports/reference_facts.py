"""What references for the flexible robot ask of the motors, for `summary.json` and the report."""

from __future__ import annotations

import numpy as np

from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.trajectories.trajectory import Trajectory

JERK_JUMP = 1e-3
"""Jump of the motion's jerk, relative to its largest jerk, above which it counts: smaller ones are rounding."""


def jerk_jump(motion: Trajectory) -> float:
    """Largest jump of the jerk [m/s³] within a motion of the end effector, 0 where there is none but rounding."""
    inner = np.array(motion.breakpoints)
    before, after = (motion.evaluate(inner, 3, side)[3] for side in ("left", "right"))
    largest = max(float(np.abs(before).max()), float(np.abs(after).max()))
    jump = float(np.hypot(*(after - before).T).max())
    return jump if jump > JERK_JUMP * largest else 0.0


def reference_facts(motion: MotionPlan) -> dict[str, float | str]:
    """What the references ask of the motors, and how smooth the motion is; a sentence if its jerk jumps."""
    design, rigid = motion.design, motion.rigid
    assert design is not None
    assert rigid is not None
    jump, largest = jerk_jump(rigid.task), design.largest_jerk
    found: dict[str, float | str] = {
        "knot_spacing": design.motors.duration / design.motors.intervals,
        "lead": 0.5 * (motion.duration - rigid.duration),
        "largest_joint_jerk": largest,
        "jerk_jump": jump,
    }
    if jump:
        found["warning"] = (
            f"the motion's jerk jumps by {jump:.3g} m/s³, so the jerk of the joints, {largest:.3g} rad/s³, grows with closer "
            "knots: smoother or wider blends, or knots further apart, keep it lower"
        )
    return found
