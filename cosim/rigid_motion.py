"""The rigid end-effector motion beside a recording, for comparison and plots."""

from __future__ import annotations

import numpy as np

from flexfmu.cosim.planning import MotionPlan
from flexfmu.cosim.results import Column, Recording

KINDS = (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s2"))
"""Order of the time derivative → its name and unit."""


def with_rigid_motion(recording: Recording, motion: MotionPlan) -> Recording:
    """The recording with ``end_effector.reference.position.x`` and so on, with their derivatives, on both sides of
    every instant that appears twice."""
    time = recording.time
    derivatives = motion.task.evaluate(time, order=4, side="right")
    left = np.flatnonzero(time[:-1] == time[1:])
    derivatives[:, left] = motion.task.evaluate(time[left], order=4, side="left")
    columns = {
        f"end_effector.reference.{kind}.{axis}": Column(unit, *derivatives[order : order + 3, :, i].copy())
        for order, (kind, unit) in enumerate(KINDS)
        for i, axis in enumerate("xy")
    }
    return recording.with_columns(columns)
