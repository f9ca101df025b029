"""A planned motion as a drive reads it: samples at its rate, in its unit or in encoder counts, and what they leave of the vibration-free motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, pi
from pathlib import Path

import numpy as np

from flexfmu.cosim.design.plans.assessment import TOLERANCE, Assessment, Candidate, Judge
from flexfmu.cosim.design.plans.goals import Goals
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import write_whole
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import PiecewisePolynomial, spline

ANGLES: Mapping[str, float] = {"rad": 1.0, "deg": 180.0 / pi, "turn": 0.5 / pi}
"""Unit of angles → how many of it are 1 rad."""

RATES = 10.0, 1e6
"""Lowest and highest rate [1/s]."""

PAYLOADS = 7
"""Payloads of the band for which the samples are judged."""

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
    """

    rate: float
    unit: str
    per_radian: float
    values: RealArray
    torque: RealArray

    @property
    def time(self) -> RealArray:
        """Instants of the samples (N,) [s]."""
        return np.arange(len(self.torque)) / self.rate

    def trajectory(self) -> PiecewisePolynomial:
        """The motion [rad] of a drive that goes through position, velocity and acceleration of each sample, by quintics between them."""
        return spline(self.time, self.values / self.per_radian, coordinates="joints")

    def to_csv(self) -> str:
        """A line for each sample; the header has units, FMU-like names joint by joint."""
        units = self.unit, f"{self.unit}/s", f"{self.unit}/s2", "N.m"
        kinds = ("position", "velocity", "acceleration", "torque")
        header = [
            "time [s]",
            *(f"joint{j}.{kind} [{unit}]" for kind, unit in zip(kinds, units, strict=True) for j in (1, 2)),
        ]
        whole = self.unit == "count"
        lines = [",".join(header)]
        for time, *rows in zip(self.time.tolist(), *self.values.tolist(), self.torque.tolist(), strict=True):
            angles = [str(int(value)) if whole else f"{value:.12g}" for row in rows[:-1] for value in row]
            lines.append(",".join([f"{time:.9g}", *angles, *(f"{value:.7g}" for value in rows[-1])]))
        return "\n".join(lines) + "\n"


def drive_table(
    candidate: Candidate, rate: float, unit: str = "rad", counts: float | None = None, *, pauses: Sequence[float] = ()
) -> DriveTable:
    """Sample a motion or a cycle for a drive.

    Args:
        candidate: the motion, or a cycle, whose last sample is that before the first one.
        rate: samples a second.
        unit: of the angles, one of `ANGLES`; without meaning for counts.
        counts: encoder counts of one turn of a joint, to which positions, velocities and accelerations are rounded; None for no rounding.
        pauses: time at rest after each way of a cycle [s].

    Raises:
        InputError: a rate or a number of counts out of range, or an unknown unit.
        TrajectoryError, ResultsError: the motion can't be planned or run.
    """
    check_drive(rate, unit, counts)
    if candidate.ways:
        tables = [_sampled(way, rate, unit, counts, pause) for way, pause in zip(candidate.ways, pauses, strict=True)]
        values, torque = (
            np.concatenate([getattr(each, name) for each in tables], axis)
            for name, axis in (("values", 1), ("torque", 0))
        )
        return replace(tables[0], values=values, torque=torque)
    return _sampled(candidate, rate, unit, counts)


def _sampled(
    candidate: Candidate, rate: float, unit: str, counts: float | None, pause: float | None = None
) -> DriveTable:
    """The samples of a motion up to its last one at rest, or with a pause up to that before the next motion."""
    run = candidate.prepared(tolerance=TOLERANCE, step=1.0 / rate).run()
    joints, steps = run.plan.joints, ceil(run.plan.joints.duration * rate - SHARE)
    if pause is not None:
        steps = max(steps, ceil((joints.duration + pause) * rate - SHARE) - 1)
    instants = np.arange(steps + 1) / rate
    values = joints.evaluate(np.minimum(instants, joints.duration), 2, "right")
    # at rest from the end on
    values[1:, instants >= joints.duration - SHARE / rate] = 0.0
    per_radian = ANGLES[unit] if counts is None else counts * ANGLES["turn"]
    values = values * per_radian
    torque = np.column_stack(
        [np.interp(instants, run.recording.time, run.recording[f"joint{joint}.torque"].values) for joint in (1, 2)]
    )
    if counts is None:
        return DriveTable(rate, unit, per_radian, values, torque)
    return DriveTable(rate, "count", per_radian, np.rint(values), torque)


def check_drive(rate: float, unit: str, counts: float | None) -> None:
    """Refuse what no drive takes; arguments and errors as for `drive_table`."""
    if not RATES[0] <= rate <= RATES[1]:
        raise InputError(
            f"the rate of a drive's table must be {RATES[0]:g} to {RATES[1]:g} samples a second, got {rate:g}"
        )
    if unit not in ANGLES:
        raise InputError(f"angles of a drive's table are in {', '.join(ANGLES)}, got {unit!r}")
    if counts is not None and not counts >= 1.0:
        raise InputError(f"the encoder's counts of a turn must be at least 1, got {counts:g}")


def write_drive_table(
    goals: Goals, candidate: Candidate, path: Path, rate: float, unit: str = "rad", counts: float | None = None
) -> tuple[DriveTable, Assessment]:
    """Write a motion as a drive reads it.

    Arguments and errors as for `drive_table`.

    Returns:
        The table, and what its samples are worth over the bands: the FMU follows the drive's motion.
    """
    table = drive_table(candidate, rate, unit, counts, pauses=[each.pause or 0.0 for each in goals.ways])
    write_whole(path, table.to_csv())
    label = f"{path.name}, {rate:g} samples a second"
    motions = [drive_table(each, rate, unit, counts).trajectory() for each in candidate.ways] or [table.trajectory()]
    parts = tuple(
        Candidate(label, "csv", each.scene, motion)
        for each, motion in zip(goals.ways or (goals,), motions, strict=True)
    )
    return table, Judge(goals, PAYLOADS).assess(replace(parts[0], ways=parts if goals.ways else ()))
