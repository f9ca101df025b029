"""A planned motion as a drive reads it: samples at its rate, in its unit or in encoder counts, and what they leave of the vibration-free motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil, inf, pi

import numpy as np

from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.design.plans.assessment import Candidate, Judge, noted
from flexfmu.cosim.engine.errors import InputError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import spline

ANGLES: Mapping[str, float] = {"rad": 1.0, "deg": 180.0 / pi, "turn": 0.5 / pi}
"""Unit of angles → how many of it are 1 rad."""

RATES = 10.0, 1e6
"""Lowest and highest rate [1/s]."""

SHARE = 1e-9
"""Share of a sample by which a motion may be longer than its last one."""


@dataclass(frozen=True, eq=False)
class DriveTable:
    """Samples of the motion of both joints, the last ones at rest.

    Attributes:
        rate: samples a second.
        unit: of the angles: rad, deg, turn or count.
        per_radian: how many of it are 1 rad.
        values: positions, velocities and accelerations (3, N, 2) in the unit and s, whole numbers of counts.
        torque: feedforward of both motors for the scene's own payload (N, 2) [N m].
        use: the residual vibration that the samples leave over the bands, with its limit: the FMU follows quintics through position,
            velocity and acceleration of each sample; infinite where the robot can't follow them.
    """

    rate: float
    unit: str
    per_radian: float
    values: RealArray
    torque: RealArray
    use: Limit

    @property
    def time(self) -> RealArray:
        """Instants of the samples (N,) [s]."""
        return np.arange(len(self.torque)) / self.rate

    def to_csv(self) -> str:
        """A line for each sample; the header has units, FMU-like names joint by joint."""
        units = self.unit, f"{self.unit}/s", f"{self.unit}/s2", "N.m"
        kinds = ("position", "velocity", "acceleration", "torque")
        names = [f"joint{j}.{kind} [{unit}]" for kind, unit in zip(kinds, units, strict=True) for j in (1, 2)]
        lines, whole = [",".join(["time [s]", *names])], self.unit == "count"
        for time, *rows in zip(self.time.tolist(), *self.values.tolist(), self.torque.tolist(), strict=True):
            angles = [str(int(value)) if whole else f"{value:.12g}" for row in rows[:-1] for value in row]
            lines.append(",".join([f"{time:.9g}", *angles, *(f"{value:.7g}" for value in rows[-1])]))
        return "\n".join(lines) + "\n"


def drive_table(
    judge: Judge, candidate: Candidate, rate: float, unit: str = "rad", counts: float | None = None
) -> DriveTable:
    """Sample a motion or a cycle for a drive.

    Args:
        judge: of the motion, which says what residual vibration the samples leave.
        candidate: the motion, or a cycle, whose last sample is that before the first one.
        rate: samples a second.
        unit: of the angles, one of `ANGLES`; without meaning for counts.
        counts: encoder counts of one turn of a joint, to which positions, velocities and accelerations are rounded; None for no rounding.

    Raises:
        InputError: a rate or a number of counts out of range, or an unknown unit.
        TrajectoryError, ResultsError: the motion can't be planned or run.
    """
    check_drive(rate, unit, counts)
    per_radian = ANGLES[unit] if counts is None else counts * ANGLES["turn"]
    values, torques, parts = list[RealArray](), list[RealArray](), list[Candidate]()
    for goals, way in zip(judge.goals.ways or (judge.goals,), candidate.ways or (candidate,), strict=True):
        run = way.prepared(step=1.0 / rate).run()
        joints = run.plan.joints
        # up to the first sample at rest; in a cycle up to that before the next motion
        moving = ceil(joints.duration * rate - SHARE)
        steps = moving
        if judge.goals.ways:
            steps = max(steps, ceil((joints.duration + (goals.pause or 0.0)) * rate - SHARE) - 1)
        instants = np.arange(steps + 1) / rate
        angles = per_radian * joints.evaluate(np.minimum(instants, joints.duration), 2, "right")
        angles[1:, instants >= joints.duration - SHARE / rate] = 0.0
        values.append(angles if counts is None else np.rint(angles))
        recording = run.recording
        torque = [np.interp(instants, recording.time, recording[f"joint{joint}.torque"].values) for joint in (1, 2)]
        torques.append(np.column_stack(torque))
        # the motion of a drive that goes through each sample by quintics
        motion = spline(instants[: moving + 1], values[-1][:, : moving + 1] / per_radian, coordinates="joints")
        parts.append(Candidate(f"{rate:g} samples a second", "csv", goals.scene, motion))
    use, failures = judge.goals.limits["residual"], list[str]()
    with noted(failures, "the robot can't follow them"):
        use = judge.assess(replace(parts[0], ways=tuple(parts) if judge.goals.ways else ())).uses[0]
    use = replace(use.used(inf, failures[0]) if failures else use, figure="residual of the samples")
    unit = unit if counts is None else "count"
    return DriveTable(rate, unit, per_radian, np.concatenate(values, axis=1), np.concatenate(torques), use)


def check_drive(rate: float, unit: str, counts: float | None) -> None:
    """Refuse what no drive takes; arguments and errors as for `drive_table`."""
    if not RATES[0] <= rate <= RATES[1]:
        raise InputError(
            f"the rate of a drive's table must be {RATES[0]:g} to {RATES[1]:g} samples a second, got {rate:g}"
        )
    if unit not in ANGLES:
        raise InputError(f"angles of a drive's table are in {', '.join(ANGLES)}, got {unit!r}")
    if counts is not None and not (counts >= 1.0 and float(counts).is_integer()):
        raise InputError(f"the encoder's counts of a turn are a whole number from 1 on, got {counts:g}")
