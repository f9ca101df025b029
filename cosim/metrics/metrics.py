"""Computes the metrics of a run from the continuous solution between the communication points, and their errors.

A recorded solution has the signals that metrics are computed from, interpolated between communication points.

The error of a metric is estimated from a companion: the same run with shorter communication steps and a tighter
tolerance. The change of the metric in the companion contains the errors of integration, input polynomials, coupling and
interpolation. One run alone can't show them: the integrator's local errors don't tell how a peak acceleration depends
on the phase of a stiff mode. The companion's value is the more accurate one, and is the metric's where there is a
companion; its error follows from the same change and from the order of convergence
(`flexfmu.cosim.many.prepared_scene`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property, partial

import numpy as np

from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.master.simulator import Progress
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.showing import few_lines
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.scene_run import Companion, Run, rest_position
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, COMMON_METRICS, LOOP_METRICS, MOTOR_METRICS, metric
from flexfmu.cosim.metrics.motors import inertia_ratios
from flexfmu.cosim.metrics.segments import Analysis, HermiteSegments
from flexfmu.cosim.metrics.signals import (
    ACCELERATION,
    FIRST_BENDING,
    JOINT_POSITIONS,
    POSITION,
    ROUNDING,
    TIP_DEFLECTIONS,
    TORQUES,
    VELOCITY,
    at_ends,
    deviation_from_point,
    deviation_from_rigid,
    joint_error,
    position,
    position_rounding,
    segments,
)
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


class Metrics(dict[str, Metric]):
    """The metrics of a run by name; for an unknown name a KeyError lists the known ones.

    Attributes:
        basis: how the errors were estimated, in one sentence.
        failure: message of a failed run, whose metrics have no values; otherwise empty.
    """

    basis: str = "no errors were estimated"
    failure: str = ""

    def __repr__(self) -> str:
        """Return at most five lines, with as many metrics as fit; `dict` has all."""
        return few_lines(f"Metrics ({self.basis}):", [f"{name}: {each!r}" for name, each in self.items()])

    def __missing__(self, name: str) -> Metric:
        if self.failure:
            raise KeyError(f"there is no metric {name!r}, since the run failed: {self.failure}")
        raise KeyError(f"this run has no metric {name!r}; there are: {', '.join(self)}")


SAFETY = 4.0
"""Factor from the change in a single companion to the run's own error; it covers the companion's error."""

LEAST_SHARE = 0.3
"""Least error of a companion, in terms of its tolerance and of the metric: a change may be small by chance."""


def measure_run(run: Run, companions: int = 1, names: Collection[str] | None = None) -> Metrics:
    """Compute metrics of a run with their errors, in the order of `ALL_METRICS`: of those that the robot has.

    A failed run has metrics without values.

    Args:
        run: the run.
        companions: number of companions to simulate. 0: values of the run, whose errors stay unknown. 1: values of a
            companion, with errors by the change to it. 2: a second, more precise companion verifies the first, and gives the values.
        names: names of the metrics to compute; None for all.

    Raises:
        InputError: there is no metric of such a name.
        ResultsError: a signal that the metrics need was not recorded or is not finite.
        EquilibriumError: the end pose has no static equilibrium.
    """
    if names is not None:
        check_names(names)
    if not run.completed:
        failed = Metrics(
            {name: metric(name, None, reason=run.message) for name in (COMMON_METRICS if names is None else names)}
        )
        failed.failure = run.message
        return failed
    settings = settings_for(run)
    # the settling time's error depends on that of the vibration
    needed = names
    if names is not None and companions and "settling_time" in names:
        needed = {*names, "residual_vibration_amplitude"}
    measured = with_errors(run, measure(run.recording, settings, needed), settings, companions)
    if names is None:
        return measured
    return _based({name: each for name, each in measured.items() if name in names}, measured.basis)


def metrics_of(run: Run, names: Collection[str] | None = None) -> dict[str, float | None]:
    """Return the values of a run's metrics by name, without their errors; None for no value.

    Arguments and errors: as for `measure_run`.
    """
    return {name: each.value for name, each in measure_run(run, 0, names).items()}


def check_names(names: Collection[str]) -> None:
    """Check names of metrics.

    Raises:
        InputError: there is no metric of such a name, or ``names`` is a single text.
    """
    if isinstance(names, str):
        raise InputError(f"metrics are asked for by a list of names, got the single text {names!r}")
    for name in names:
        if name not in ALL_METRICS:
            near = get_close_matches(str(name), ALL_METRICS, n=1, cutoff=0.0)
            raise InputError(f"there is no metric {name!r}; did you mean {near[0]!r}?")


def with_errors(
    run: Run, measured: Mapping[str, Metric], settings: Settings, companions: int = 1, progress: Progress | None = None
) -> Metrics:
    """Add errors to the metrics of a completed run: from companions, and of figures with an accuracy, of model and numerics together.

    Args:
        run: the run.
        measured: its metrics without errors.
        settings: as for `measure`.
        companions: as for `measure_run`.
        progress: passed to the companions' runs.
    """
    figures = () if run.accuracy is None else run.accuracy.figures
    proven = {
        each.name: measured[each.name].changed(error=each.total, own_error=each.total)
        for each in figures
        if each.name in measured
    }
    found = _beside_companions(run, measured, settings, 0 if proven.keys() == measured.keys() else companions, progress)
    if not proven:
        return found
    return _based(
        found | proven, f"{found.basis}; for {', '.join(proven)} they are of the run and of the model's effects"
    )


def _beside_companions(
    run: Run, measured: Mapping[str, Metric], settings: Settings, companions: int, progress: Progress | None
) -> Metrics:
    """The metrics with errors from companions; arguments as for `with_errors`."""
    # runs with ever smaller steps and tolerances, each the companion of the one before
    results, finest, how, companion = [measured], run, list[str](), None
    while len(how) < companions and finest.companion is not None:
        companion = finest.companion
        finest = companion.run(progress)
        how.append(f"steps of {companion.communication_step:.3g} s and a tolerance of {companion.tolerance:.2g}")
        if not finest.completed:
            return _based(measured, f"errors are not known: {finest.message}, in a companion with {how[-1]}")
        results.append(measure(finest.recording, settings, measured))
    if companion is None or run.companion is None:
        return _based(measured, Metrics.basis)

    # error of each metric: its change in the companions, and rounding
    rounding = {name: each.rounding + ROUNDING * _magnitude(run, name) for name, each in measured.items()}
    stated = {name: _stated([one.get(name) for one in results], rounding[name], companion) for name in measured}
    _settle(stated, [run.recording, finest.recording], settings)
    if len(how) == 1:
        return _based(stated, f"errors are taken from a companion run with {how[0]}, and so are the values")
    # a second companion shows whether the error of the first one would have been understated
    missed = list[str]()
    for name in stated:
        first, final = (
            _stated([one.get(name) for one in results[:2]], rounding[name], run.companion),
            stated[name].value,
        )
        if first.error is not None and first.value is not None and final is not None:
            missed += [name] if abs(first.value - final) > first.error else []
    verdict = f"; one companion alone understates {', '.join(missed)}" if missed else ""
    return _based(stated, f"errors are verified by companion runs with {' and '.join(how)}{verdict}")


def _based(measured: Mapping[str, Metric], basis: str) -> Metrics:
    """Return the metrics with the basis of their errors."""
    found = Metrics(measured)
    found.basis = basis
    return found


def _stated(results: Sequence[Metric | None], rounding: float, finest: Companion) -> Metric:
    """Return a metric from its values in the run and in ever finer companions: the finest one, and the run's own."""
    first = Metric(None) if results[0] is None else results[0]
    values = [each.value for each in results if each is not None and each.value is not None]
    if first.value is None or len(values) < len(results):
        return first
    # the run's error, then that of the finest companion
    change, last = abs(first.value - values[-1]), abs(values[-2] - values[-1])
    own_error = rounding + (SAFETY * change if len(values) == 2 else change + last)
    least = LEAST_SHARE * finest.tolerance * abs(values[-1])
    return first.changed(
        value=values[-1],
        error=rounding + max(finest.share * last, least),
        own=first.value,
        own_error=own_error,
        interpolation_error=min(first.interpolation_error, own_error),
    )


def _settle(stated: dict[str, Metric], recordings: Sequence[Recording], settings: Settings) -> None:
    """Increase the settling time's errors to its change when the vibration grows or shrinks by its own error.

    A settling time jumps by half a period where a crest just touches the settling band.

    Args:
        stated: the metrics, which change.
        recordings: of the run, and of its finest companion.
        settings: as for `measure`.
    """
    settled, vibration = stated.get("settling_time"), stated.get("residual_vibration_amplitude")
    if settled is None or vibration is None or settled.error is None or vibration.error is None:
        return
    moved = [
        RecordedSolution(recording, settings).settling_time(error or 0.0).interpolation_error
        for recording, error in zip(recordings, (vibration.own_error, vibration.error), strict=True)
    ]
    own_error, error = (
        max(one or 0.0, other) for one, other in zip((settled.own_error, settled.error), moved, strict=True)
    )
    stated["settling_time"] = settled.changed(own_error=own_error, error=error)


def _magnitude(run: Run, name: str) -> float:
    """Return the largest magnitude of the signals that a metric is computed from; 0 where none is recorded.

    An acceleration is what gravity and the forces that hold it leave.
    """
    columns = {"time": run.recording.time} | {each: column.values for each, column in run.recording.columns.items()}
    known = [each for each in ALL_METRICS[name].columns if each in columns]
    least = np.hypot(*run.scene.effects.gravity) if any("acceleration" in each for each in known) else 0.0
    return max((float(np.abs(columns[each]).max()) for each in known), default=0.0) + float(least)


def settings_for(run: Run) -> Settings:
    """Return the data that the metrics of a run depend on besides its recording."""
    (task, joints), band = run.plan.tabulated, run.scene.cosimulation.settling_band
    cycles = 1 if run.plan.repetition is None else run.plan.repetition.cycles
    ratios = None if run.scene.motor is None else partial(inertia_ratios, run)
    return Settings(task, partial(rest_position, run), run.scene.trajectory.dwell, band, joints, cycles, ratios)


def measure(recording: Recording, settings: Settings, names: Collection[str] | None = None) -> Metrics:
    """Compute metrics of a complete recording without their errors, in the order of `ALL_METRICS`.

    Args:
        recording: signals with their time derivatives.
        settings: planned motion, equilibrium and so on.
        names: names of the metrics to compute; None for all that the robot has.

    Raises:
        InputError: the robot doesn't have a metric of ``names``.
        ResultsError: a signal that the metrics need was not recorded or is not finite.
        EquilibriumError: the end pose has no static equilibrium.
    """
    solution = RecordedSolution(recording, settings)
    needs = (
        dict.fromkeys(LOOP_METRICS, "joint angles of a robot driven by torques") if not solution.tracks_joints else {}
    )
    needs |= dict.fromkeys(MOTOR_METRICS, "a scene with `[motor]`") if settings.inertia_ratios is None else {}
    # not `metric`, which Python 3.12.1 would not find two comprehensions on
    available = {name: kind for name, kind in ALL_METRICS.items() if name not in needs}
    for name in names or ():
        if name in needs:
            raise InputError(f"there is no metric {name!r} of this run: it needs {needs[name]}")
    wanted = [name for name in available if names is None or name in names]
    found = Metrics({name: metric(name, available[name].computation(solution)) for name in wanted})
    for name, each in found.items():
        if each.value is not None and not math.isfinite(each):
            raise ResultsError(f"metric `{name}` is {each.value}: the recorded signals are not finite")
    return found


PEAKS: Mapping[str, str] = {
    **{f"peak_torque_{joint}": name for joint, name in enumerate(TORQUES, start=1)},
    **{f"peak_tip_deflection_{leg}": name for leg, name in enumerate(TIP_DEFLECTIONS, start=1)},
}
"""Metrics that are the largest magnitude of one output over the motion → name of the output."""


SIGNALS = (*TORQUES, *TIP_DEFLECTIONS, *POSITION, *VELOCITY, *ACCELERATION, FIRST_BENDING, f"der({FIRST_BENDING},2)")
"""The recorded signals that any metric of a motion-driven robot needs."""


@dataclass(frozen=True)
class ChosenMetrics:
    """The values of some metrics of a run, by name; None for no value.

    Attributes:
        names: names of the metrics.
    """

    names: tuple[str, ...]

    def __call__(self, run: Run) -> dict[str, float | None]:
        """Measure a run."""
        found = metrics_of(run, self.names)
        return {name: found[name] for name in self.names}

    @property
    def signals(self) -> Sequence[str]:
        """The outputs that the metrics need, with two derivatives."""
        return SIGNALS


@dataclass(frozen=True)
class PeakMetrics(ChosenMetrics):
    """The values of metrics that are peaks of outputs, see `PEAKS`."""

    @property
    def outputs(self) -> Sequence[str]:
        """Names of the outputs."""
        return tuple(PEAKS[name] for name in self.names)

    def of_peaks(self, peaks: Mapping[str, float]) -> dict[str, float | None]:
        """The metrics from the peaks, name of an output → largest magnitude over the motion."""
        return {name: peaks[PEAKS[name]] for name in self.names}


def measuring(names: Collection[str]) -> ChosenMetrics:
    """Return the measure of these metrics, as a sweep takes it: ``run_variants(scene, variants, measuring(names))``.

    `flexfmu.cosim.many.variants.run_variants` then simulates variants side by side; peaks of torques and of tip
    deflections alone are the fastest.

    Raises:
        InputError: there is no metric of such a name.
    """
    check_names(names)
    return (PeakMetrics if all(name in PEAKS for name in names) else ChosenMetrics)(tuple(names))
