"""The solution of a recorded run, from which metrics are computed: its signals, interpolated between communication points."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.metrics.segments import Analysis, HermiteSegments
from flexfmu.cosim.metrics.signals import (
    FIRST_BENDING,
    JOINT_POSITIONS,
    TIP_DEFLECTIONS,
    TORQUES,
    at_ends,
    deviation_from_point,
    deviation_from_rigid,
    joint_error,
    position,
    position_rounding,
    segments,
)

if TYPE_CHECKING:
    from flexfmu.trajectories.trajectory import Trajectory

SHAPE = 2.0 / 3.0
"""Largest mean of an interpolation error over a segment in terms of its peak: that of theta (1 - theta); others are slimmer."""


def joint_speed(recording: Recording, joint: int, planned: Trajectory | None) -> HermiteSegments | None:
    """Return the angular velocity of a motor [rad/s] with two derivatives; None where it isn't known.

    Args:
        recording: of any robot; its joint velocity or its reference, where that drives the motors.
        joint: 0 or 1.
        planned: joint trajectory, used where neither was recorded.
    """
    for name in (f"joint{joint + 1}.velocity", f"joint{joint + 1}.reference.velocity"):
        if name in recording.columns:
            return segments(recording, [name])
    if planned is None:
        return None
    torque = segments(recording, TORQUES[joint : joint + 1])
    # the fourth derivative comes along, as for other metrics, which share the table
    begin, end = (each[1:4, :, joint : joint + 1] for each in at_ends(torque, planned, 4))
    return HermiteSegments(torque.start, torque.end, begin, end)


def product(first: HermiteSegments, second: HermiteSegments) -> HermiteSegments:
    """Return the product of two signals with one channel and two derivatives each, by Leibniz' rule."""

    def derivatives(u: RealArray, v: RealArray) -> RealArray:
        return np.stack([u[0] * v[0], u[1] * v[0] + u[0] * v[1], u[2] * v[0] + 2.0 * u[1] * v[1] + u[0] * v[2]])

    left, right = derivatives(first.left, second.left), derivatives(first.right, second.right)
    return HermiteSegments(first.start, first.end, left, right)


@dataclass(frozen=True)
class RecordedPower:
    """A power, interpolated between communication points."""

    segments: HermiteSegments
    cycles: int

    @cached_property
    def _parts(self) -> tuple[float, ...]:
        return Analysis(self.segments).parts()

    def peak(self, sign: int) -> Metric:
        """Largest positive or negated negative power."""
        return Metric(self._parts[0 if sign > 0 else 1], interpolation_error=self._parts[4])

    def energy(self, sign: int) -> Metric:
        """Energy a cycle of the positive part, of the negated negative part, or the sum of both."""
        positive, negative = (
            Metric(self._parts[2 + k] / self.cycles, interpolation_error=SHAPE * self._parts[5 + k] / self.cycles)
            for k in (0, 1)
        )
        return self._difference(self.cycles) if sign == 0 else positive if sign > 0 else negative

    def mean(self) -> Metric:
        """Mean over time."""
        return self._difference(float(self.segments.duration.sum()))

    def _difference(self, divisor: float) -> Metric:
        """Return the integral of both parts over a divisor."""
        _, _, positive, negative, _, first, second = self._parts
        return Metric((positive - negative) / divisor, interpolation_error=SHAPE * (first + second) / divisor)


@dataclass(frozen=True)
class Settings:
    """Data that the metrics depend on besides the recording.

    Attributes:
        task: motion of the rigid robot's end effector.
        rest: function that returns `end_equilibrium`; called if a metric needs it.
        joints: planned motion of the joints; None for no tracking errors.
        cycles: number of cycles in the recording.
        inertia_ratios: function that returns the largest inertia ratio of each joint; None for a scene without motors.
        dwell: standstill after the motion [s].
        settling_band: radius around the equilibrium within which the robot counts as settled [m].
    """

    task: Trajectory
    rest: Callable[[], RealArray]
    dwell: float
    settling_band: float
    joints: Trajectory | None = None
    cycles: int = 1
    inertia_ratios: Callable[[], Sequence[float | None]] | None = None

    @cached_property
    def end_equilibrium(self) -> RealArray:
        """(2,) end-effector position [m] of the static equilibrium at the end pose.

        Raises:
            EquilibriumError: the end pose has no static equilibrium.
        """
        return self.rest()

    @cached_property
    def largest_inertia_ratios(self) -> Sequence[float | None]:
        """The largest inertia ratio of each joint; None where it isn't known."""
        return self.inertia_ratios() if self.inertia_ratios is not None else (None, None)


@dataclass(frozen=True)
class RecordedSignal:
    """A recorded signal, interpolated between communication points.

    Attributes:
        segments: the signal.
        rounding: error of its values by rounding, in its unit; counts where a second derivative is taken.
    """

    segments: HermiteSegments
    rounding: float = 0.0

    @cached_property
    def _analysis(self) -> Analysis:
        return Analysis(self.segments)

    def peak(self) -> Metric:
        """Largest norm; its error is how far another segment may exceed it, at least the peak segment's error."""
        value, exceeded = self._analysis.peak()
        return Metric(value, interpolation_error=exceeded)

    def root_mean_square(self, order: int = 0) -> Metric:
        """Root mean square of the norm of a time derivative p; its error follows from the estimated deviation e of p.

        To second order e changes the root mean square by (mean of p e + half the mean of e²) / root mean square.
        """
        analysis, noise = self._analysis, 0.0
        if order == 2:
            resolving, noise = self.segments.resolving_curvature(self.rounding)
            analysis = analysis if resolving is self.segments else Analysis(resolving)
        squares, common, deviation = analysis.mean_products(order)
        root, bound, change = math.sqrt(squares), math.sqrt(deviation), abs(common) + 0.5 * deviation
        if root == 0.0:
            return Metric(root, interpolation_error=bound, rounding=noise)
        return Metric(root, interpolation_error=min(change / root, bound), rounding=min(noise, 0.5 * noise**2 / root))

    def final(self, order: int = 0) -> Metric:
        """Norm of a time derivative at the last communication point, without interpolation error."""
        return Metric(float(np.linalg.norm(self.segments.right[order, -1])))

    def settling(self, band: float, uncertainty: float = 0.0) -> Metric:
        """Time from the first segment's start after which the norm stays below ``band`` [s]; None if it never does.

        Its error is the shift of the last crossing when the amplitude changes by the interpolation error or the
        ``uncertainty``, whichever is larger; both have the unit of ``band``.
        """
        vibration, analysis = self.segments, self._analysis
        begin, stop = float(vibration.start[0]), float(vibration.end[-1])
        crossing = analysis.last_time_above(band)
        if crossing is None:
            return Metric(0.0)
        # last crossings of a band that is wider and narrower by the error
        near = int(np.searchsorted(vibration.end, crossing))
        error = max(float(analysis.errors[min(near, len(vibration.end) - 1)]), uncertainty)
        spread = [analysis.last_time_above(level) for level in (band + error, max(band - error, 0.0))]
        early, late = (begin if time is None else time for time in spread)
        return Metric(crossing - begin if crossing < stop else None, interpolation_error=late - early)


REST = RecordedSignal(HermiteSegments(np.zeros(1), np.ones(1), np.zeros((3, 1, 1)), np.zeros((3, 1, 1))))
"""Deflection of a rigid link, exactly zero."""


class RecordedSolution:
    """The signals of a complete recording, interpolated when first needed; None for a signal that the robot doesn't have.

    Motion means 0 < t < T with one-sided limits at both ends; the dwell follows it.

    Args:
        recording: signals with their time derivatives.
        settings: planned motion, end equilibrium, dwell and settling band.

    Attributes:
        tracks_joints: whether tracking errors exist: a torque-driven robot with a planned joint motion.
    """

    def __init__(self, recording: Recording, settings: Settings) -> None:
        self._recording, self._settings, self._end = recording, settings, settings.task.duration
        # signals of the duty cycle by joint
        self._torques, self._speeds = dict[int, RecordedSignal](), dict[int, RecordedSignal | None]()
        self._powers = dict[int, RecordedPower]()
        self.tracks_joints = settings.joints is not None and all(name in recording.columns for name in JOINT_POSITIONS)

    def torque(self, joint: int) -> RecordedSignal:
        """Torque of motor 1 or 2 over the motion [N.m]."""
        return self._in_motion(self.duty_torque(joint).segments)

    def modal_deflection(self) -> RecordedSignal:
        """First bending coordinate of proximal link 1 over the motion [m]; zero for a rigid link."""
        if FIRST_BENDING not in self._recording.columns:
            return REST
        acceleration = f"der({FIRST_BENDING},2)"
        known = [acceleration] if acceleration in self._recording.columns else ()
        return self._in_motion(segments(self._recording, [FIRST_BENDING], known))

    def tip_deflection(self, leg: int) -> RecordedSignal:
        """Transverse displacement of the tip of proximal link 1 or 2 over the motion [m]; zero for a rigid link."""
        name = TIP_DEFLECTIONS[leg - 1]
        return self._in_motion(segments(self._recording, [name])) if name in self._recording.columns else REST

    def path_error(self) -> RecordedSignal:
        """Deviation of the end effector from the rigid robot's over motion and dwell [m]."""
        return RecordedSignal(self._path_error)

    def path_error_in_motion(self) -> RecordedSignal:
        """Deviation of the end effector from the rigid robot's over the motion alone [m]."""
        return self._path_error_in_motion

    def residual_vibration(self) -> RecordedSignal | None:
        """Deviation of the end effector from the equilibrium at the end pose during the dwell [m]."""
        # a dwell that is too short for a communication point is none
        return self._vibration if self._settings.dwell and self._vibration.segments.start.size else None

    def tracking_error(self, joint: int) -> RecordedSignal | None:
        """Angle of motor 1 or 2 minus its planned angle, over motion and dwell [rad]."""
        error = self._tracking_error(joint)
        return None if error is None else RecordedSignal(error)

    def tracking_error_in_motion(self, joint: int) -> RecordedSignal | None:
        """Angle of motor 1 or 2 minus its planned angle, over the motion alone [rad]."""
        error = self._tracking_error(joint)
        return None if error is None else self._in_motion(error)

    def settling_time(self, uncertainty: float = 0.0) -> Metric:
        """Time after the motion from which the residual vibration stays within the settling band [s].

        ``uncertainty`` as for `RecordedSignal.settling`.
        """
        vibration = self.residual_vibration()
        return Metric(None) if vibration is None else vibration.settling(self._settings.settling_band, uncertainty)

    def duty_torque(self, joint: int) -> RecordedSignal:
        """Torque of motor 1 or 2 over the duty cycle: all motions and standstills [N.m]."""
        if joint not in self._torques:
            self._torques[joint] = RecordedSignal(segments(self._recording, TORQUES[joint - 1 : joint]))
        return self._torques[joint]

    def duty_speed(self, joint: int) -> RecordedSignal | None:
        """Angular velocity of motor 1 or 2 over the duty cycle [rad/s]."""
        if joint not in self._speeds:
            speed = joint_speed(self._recording, joint - 1, self._settings.joints)
            self._speeds[joint] = None if speed is None else RecordedSignal(speed)
        return self._speeds[joint]

    def duty_power(self, joint: int) -> RecordedPower | None:
        """Mechanical power of motor 1 or 2 over the duty cycle, positive into the robot [W]."""
        torque, speed = self.duty_torque(joint), self.duty_speed(joint)
        if speed is not None and joint not in self._powers:
            self._powers[joint] = RecordedPower(product(torque.segments, speed.segments), self._settings.cycles)
        return self._powers.get(joint)

    def inertia_ratio(self, joint: int) -> Metric:
        """Largest inertia of the load over the rotor's, both seen by motor 1 or 2."""
        return Metric(self._settings.largest_inertia_ratios[joint - 1])

    def _in_motion(self, signal: HermiteSegments) -> RecordedSignal:
        return RecordedSignal(signal.within(0.0, self._end))

    @cached_property
    def _position(self) -> HermiteSegments:
        return position(self._recording)

    @cached_property
    def _path_error(self) -> HermiteSegments:
        return deviation_from_rigid(self._position, self._settings.task)

    @cached_property
    def _path_error_in_motion(self) -> RecordedSignal:
        return replace(self._in_motion(self._path_error), rounding=position_rounding(self._recording))

    @cached_property
    def _vibration(self) -> RecordedSignal:
        vibration = self._position.within(self._end, math.inf)
        return RecordedSignal(deviation_from_point(vibration, self._settings.end_equilibrium))

    def _tracking_error(self, joint: int) -> HermiteSegments | None:
        planned = self._settings.joints
        if planned is None or not self.tracks_joints:
            return None
        return joint_error(self._recording, joint - 1, planned)
