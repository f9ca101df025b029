"""Computes the metrics of a run from the continuous solution between the communication points, and their errors.

Motion means 0 < t < T with one-sided limits at both ends; the dwell follows it.

The error of a metric is estimated from a companion: the same run with shorter communication steps and a tighter
tolerance. The change of the metric in the companion contains the errors of integration, input polynomials, coupling and
interpolation. One run alone can't show them: the integrator's local errors don't tell how a peak acceleration depends
on the phase of a stiff mode.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.scene_run import Run, rest_position
from flexfmu.cosim.metrics.bernstein import last_time_above
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, METRICS, Measurement, Solution
from flexfmu.cosim.metrics.segments import HermiteSegments
from flexfmu.cosim.metrics.signals import (
    JOINT_POSITIONS,
    TIP_DEFLECTIONS,
    TORQUES,
    deviation_from_point,
    deviation_from_rigid,
    joint_error,
    modal_deflection,
    position,
    segments,
)

if TYPE_CHECKING:
    from flexfmu.cosim.engine.master.simulation_loop import Progress
    from flexfmu.trajectories.trajectory import Trajectory

T = TypeVar("T")


class Metrics(dict[str, T]):
    """The metrics of a run by name; for an unknown name a KeyError lists the known ones.

    Attributes:
        basis: how the errors were estimated, in one sentence.
        failure: message of a failed run, whose metrics have no values; otherwise empty.
    """

    basis: str = "no errors were estimated"
    failure: str = ""

    def __missing__(self, name: str) -> T:
        if self.failure:
            raise KeyError(f"there is no metric {name!r}, since the run failed: {self.failure}")
        raise KeyError(f"this run has no metric {name!r}; there are: {', '.join(self)}")


@dataclass(frozen=True)
class Settings:
    """Data that the metrics depend on besides the recording.

    Attributes:
        task: motion of the rigid robot's end effector.
        joints: planned motion of the joints; None for no tracking errors.
        end_equilibrium: (2,) end-effector position [m] of the static equilibrium at the end pose.
        dwell: standstill after the motion [s].
        settling_band: radius around the equilibrium within which the robot counts as settled [m].
    """

    task: Trajectory
    end_equilibrium: RealArray
    dwell: float
    settling_band: float
    joints: Trajectory | None = None


SAFETY = 4.0
"""Factor from the change in a single companion to the error; it covers the companion's own error."""

ROUNDING = 8.0 * np.finfo(float).eps
"""Rounding error of a metric, relative to the largest magnitude of the signals that it is computed from."""


def measure_run(run: Run, companions: int = 1) -> Metrics[Measurement]:
    """Compute all metrics of a run with their errors, in the order of `METRICS` and, with torque drive, `LOOP_METRICS`.

    A failed run has metrics without values.

    Args:
        run: the run.
        companions: number of companions to simulate for the errors. 0: the errors stay unknown. 1: the change in the
            companion times `SAFETY`. 2: a second, more precise companion verifies the first.

    Raises:
        ResultsError: a signal that the metrics need was not recorded or is not finite.
        EquilibriumError: the end pose has no static equilibrium.
    """
    if not run.completed:
        failed = Metrics(dict.fromkeys(METRICS, Measurement(None, reason=run.message)))
        failed.failure = run.message
        return failed
    settings = settings_for(run)
    return with_errors(run, measure(run.recording, settings), settings, companions)


def with_errors(
    run: Run,
    measured: Mapping[str, Measurement],
    settings: Settings,
    companions: int = 1,
    progress: Progress | None = None,
) -> Metrics[Measurement]:
    """Add errors from companions to the metrics of a completed run.

    Args:
        run: the run.
        measured: its metrics without errors.
        settings: as for `measure`.
        companions: as for `measure_run`.
        progress: passed to the companions' runs.
    """
    # runs with ever smaller steps and tolerances, each the companion of the one before
    results, finest, how = [measured], run, list[str]()
    while len(how) < companions and finest.companion is not None:
        companion = finest.companion
        finest = companion.run(progress)
        how.append(f"steps of {companion.communication_step:.3g} s and a tolerance of {companion.tolerance:.2g}")
        if not finest.completed:
            return _based(measured, f"errors are not known: {finest.message}, in a companion with {how[-1]}")
        results.append(measure(finest.recording, settings))
    if not how:
        return _based(measured, Metrics.basis)

    # error of each metric: its change in the companions, and rounding
    rounding = {name: ROUNDING * _magnitude(run.recording, name) for name in measured}
    rounding["rms_acceleration_error"] += _curvature_rounding(run.recording, measured["rms_acceleration_error"].value)
    stated = {name: _stated([one.get(name) for one in results], rounding[name]) for name in measured}
    _settle(stated, run.recording, settings)
    if len(how) == 1:
        return _based(stated, f"errors are taken from a companion run with {how[0]}")
    # a second companion shows whether the first one alone would understate an error
    missed = [name for name in stated if _is_missed([one.get(name) for one in results], rounding[name])]
    verdict = f"; one companion alone understates {', '.join(missed)}" if missed else ""
    return _based(stated, f"errors are verified by companion runs with {' and '.join(how)}{verdict}")


def _based(measured: Mapping[str, Measurement], basis: str) -> Metrics[Measurement]:
    """Return the metrics with the basis of their errors."""
    found = Metrics(measured)
    found.basis = basis
    return found


def _stated(results: Sequence[Measurement | None], rounding: float) -> Measurement:
    """Return a metric with its error, from its values in the run and in ever finer companions."""
    first = results[0] or Measurement(None)
    values = [each.value for each in results if each is not None and each.value is not None]
    if first.value is None or len(values) < len(results):
        return first
    change = abs(first.value - values[-1])
    error = rounding + (SAFETY * change if len(values) == 2 else change + abs(values[-2] - values[-1]))
    return replace(first, error=error, interpolation_error=min(first.interpolation_error, error))


def _is_missed(results: Sequence[Measurement | None], rounding: float) -> bool:
    """Whether the finest run contradicts the error that the first companion gives."""
    early, final = _stated(results[:2], rounding).error, _stated([results[0], results[-1]], rounding).error
    return early is not None and final is not None and (final - rounding) / SAFETY > early


def _settle(stated: dict[str, Measurement], recording: Recording, settings: Settings) -> None:
    """Increase the settling time's error to its change when the vibration grows or shrinks by its own error.

    A settling time jumps by half a period where a crest just touches the settling band.
    """
    settled, radius = stated["settling_time"], stated["residual_vibration_amplitude"].error
    if settled.error is None or radius is None:
        return
    moved = RecordedSolution(recording, settings).settling_time(radius).interpolation_error
    stated["settling_time"] = replace(settled, error=max(settled.error, moved))


def _curvature_rounding(recording: Recording, value: float | None) -> float:
    """Return the RMS acceleration's error [m/s2] from positions' rounding, differentiated over the shortest step."""
    steps = np.diff(recording.time)
    curvature = 8.0 * ROUNDING * _magnitude(recording, "peak_position_error") / float(steps[steps > 0.0].min()) ** 2
    return min(curvature, 0.5 * curvature**2 / value) if value else curvature


def _magnitude(recording: Recording, name: str) -> float:
    """Return the largest magnitude of the signals that a metric is computed from; 0 where none is recorded."""
    columns = {"time": recording.time} | {each: column.values for each, column in recording.columns.items()}
    values = [columns[each] for each in ALL_METRICS[name].columns if each in columns]
    return max((float(np.abs(each).max()) for each in values), default=0.0)


def settings_for(run: Run) -> Settings:
    """Return the data that the metrics of a run depend on besides its recording.

    Raises:
        EquilibriumError: the end pose has no static equilibrium.
    """
    (task, joints), band = run.plan.tabulated, run.scene.cosimulation.settling_band
    return Settings(task, rest_position(run), run.scene.trajectory.dwell, band, joints)


def measure(recording: Recording, settings: Settings) -> Metrics[Measurement]:
    """Compute all metrics of a complete recording without their errors, in the order of `METRICS` and `LOOP_METRICS`.

    Raises:
        ResultsError: a signal that the metrics need was not recorded or is not finite.
    """
    solution = RecordedSolution(recording, settings)
    names = ALL_METRICS if solution.tracks_joints else METRICS
    found = Metrics({name: ALL_METRICS[name].computation(solution) for name in names})
    for name, measurement in found.items():
        if measurement.value is not None and not math.isfinite(measurement.value):
            raise ResultsError(f"metric `{name}` is {measurement.value}: the recorded signals are not finite")
    return found


@dataclass(frozen=True)
class RecordedSignal:
    """A recorded signal, interpolated between communication points; see
    `flexfmu.cosim.metrics.metric_table.TimeSignal`."""

    segments: HermiteSegments

    def peak(self) -> Measurement:
        """Largest norm; its error is how far another segment may exceed it, at least the peak segment's error."""
        signal = self.segments.consistent
        return Measurement(signal.maximum_norm(), signal.peak_error())

    def root_mean_square(self, order: int = 0) -> Measurement:
        """Root mean square of the norm of a time derivative p; its error follows from the estimated deviation e of p.

        To second order e changes the root mean square by (mean of p e + half the mean of e²) / root mean square.
        """
        signal = self.segments.consistent
        points, _ = signal.quadrature
        values, deviation = signal.evaluate(points, order), signal.deviation_estimate(points, order)
        root = math.sqrt(signal.mean_product(values, values))
        bound = math.sqrt(signal.mean_product(deviation, deviation))
        change = abs(signal.mean_product(values, deviation)) + 0.5 * bound**2
        return Measurement(root, min(change / root, bound) if root > 0.0 else bound)

    def final(self, order: int = 0) -> Measurement:
        """Norm of a time derivative at the last communication point, without interpolation error."""
        return Measurement(float(np.linalg.norm(self.segments.right[order, -1])))

    def settling(self, band: float, uncertainty: float = 0.0) -> Measurement:
        """Time from the first segment's start after which the norm stays below ``band`` [s]; None if it never does.

        Its error is the shift of the last crossing when the amplitude changes by the interpolation error or the
        ``uncertainty``, whichever is larger; both have the unit of ``band``.
        """
        vibration = self.segments.consistent
        begin, stop = float(vibration.start[0]), float(vibration.end[-1])
        crossing = last_time_above(vibration.control, vibration.start, vibration.duration, band)
        if crossing is None:
            return Measurement(0.0)
        # last crossings of a band that is wider and narrower by the error
        near = int(np.searchsorted(vibration.end, crossing))
        error = max(float(vibration.error_estimate()[min(near, len(vibration.end) - 1)]), uncertainty)
        spread = [
            last_time_above(vibration.control, vibration.start, vibration.duration, level)
            for level in (band + error, max(band - error, 0.0))
        ]
        early, late = (begin if time is None else time for time in spread)
        return Measurement(crossing - begin if crossing < stop else None, late - early)


class NoSignal:
    """Deflection of a rigid link, exactly zero; see `flexfmu.cosim.metrics.metric_table.TimeSignal`."""

    def peak(self) -> Measurement:
        """Zero."""
        return Measurement(0.0)

    def root_mean_square(self, order: int = 0) -> Measurement:
        """Zero."""
        return Measurement(0.0)

    def final(self, order: int = 0) -> Measurement:
        """Zero."""
        return Measurement(0.0)


class RecordedSolution(Solution):
    """The signals of a complete recording, interpolated when first needed; methods as in `Solution`.

    Args:
        recording: signals with their time derivatives.
        settings: planned motion, end equilibrium, dwell and settling band.

    Attributes:
        tracks_joints: whether tracking errors exist: a torque-driven robot with a planned joint motion.
    """

    def __init__(self, recording: Recording, settings: Settings) -> None:
        self._recording, self._settings, self._end = recording, settings, settings.task.duration
        self.tracks_joints = settings.joints is not None and all(name in recording.columns for name in JOINT_POSITIONS)

    def torque(self, joint: int) -> RecordedSignal:
        return self._in_motion(segments(self._recording, TORQUES[joint - 1 : joint]))

    def modal_deflection(self) -> RecordedSignal | NoSignal:
        modal = modal_deflection(self._recording)
        return NoSignal() if modal is None else self._in_motion(modal)

    def tip_deflection(self, leg: int) -> RecordedSignal | NoSignal:
        name = TIP_DEFLECTIONS[leg - 1]
        return self._in_motion(segments(self._recording, [name])) if name in self._recording.columns else NoSignal()

    def path_error(self) -> RecordedSignal:
        return RecordedSignal(self._path_error)

    def path_error_in_motion(self) -> RecordedSignal:
        return self._path_error_in_motion

    def residual_vibration(self) -> RecordedSignal | None:
        return self._vibration if self._settings.dwell else None

    def tracking_error(self, joint: int) -> RecordedSignal | None:
        error = self._tracking_error(joint)
        return None if error is None else RecordedSignal(error)

    def tracking_error_in_motion(self, joint: int) -> RecordedSignal | None:
        error = self._tracking_error(joint)
        return None if error is None else self._in_motion(error)

    def settling_time(self, uncertainty: float = 0.0) -> Measurement:
        """As in `Solution`; ``uncertainty`` as for `RecordedSignal.settling`."""
        vibration = self.residual_vibration()
        return Measurement(None) if vibration is None else vibration.settling(self._settings.settling_band, uncertainty)

    def _in_motion(self, signal: HermiteSegments) -> RecordedSignal:
        return RecordedSignal(signal.within(0.0, self._end))

    @cached_property
    def _path_error(self) -> HermiteSegments:
        return deviation_from_rigid(position(self._recording), self._settings.task)

    @cached_property
    def _path_error_in_motion(self) -> RecordedSignal:
        return self._in_motion(self._path_error)

    @cached_property
    def _vibration(self) -> RecordedSignal:
        vibration = deviation_from_point(position(self._recording), self._settings.end_equilibrium)
        return RecordedSignal(vibration.within(self._end, math.inf))

    def _tracking_error(self, joint: int) -> HermiteSegments | None:
        planned = self._settings.joints
        if planned is None or not self.tracks_joints:
            return None
        return joint_error(self._recording, joint - 1, planned)


def metrics_of(run: Run) -> dict[str, float | None]:
    """Return the values of a run's metrics by name, without their errors; None for no value."""
    return Metrics({name: each.value for name, each in measure_run(run, companions=0).items()})
