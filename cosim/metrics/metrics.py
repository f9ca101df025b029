"""Metrics of a run: properties of the continuous solution between the communication points, and their errors.

Motion means 0 < t < T with one-sided limits at both ends; the dwell follows it.

The error of a metric is taken from a companion: the same run with shorter communication steps and a tighter tolerance. What
it changes is what integration, the polynomials of the inputs, coupling and interpolation have cost together. Estimates from
within one run can't show this: the integrator's local errors say nothing about how a peak acceleration depends on the phase
of a stiff mode.
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
    """What is known of each metric of a run, by name; a KeyError lists the names that exist.

    Attributes:
        basis: what their errors are taken from, in one sentence.
        failure: message of the run where it failed, so that no metric has a value; empty otherwise.
    """

    basis: str = "no errors were estimated"
    failure: str = ""

    def __missing__(self, name: str) -> T:
        if self.failure:
            raise KeyError(f"there is no metric {name!r}, since the run failed: {self.failure}")
        raise KeyError(f"this run has no metric {name!r}; there are: {', '.join(self)}")


@dataclass(frozen=True)
class Settings:
    """What the metrics depend on beside the recording.

    Attributes:
        task: motion of the rigid robot's end effector.
        joints: planned motion of the joints; None where their tracking is not of interest.
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
"""A stated error over the companion's change of the metric. The change is the error, but for that of the companion itself."""

ROUNDING = 8.0 * np.finfo(float).eps
"""Rounding of a metric, relative to the largest magnitude of the signals that it is made of."""


def measure_run(run: Run, companions: int = 1) -> Metrics[Measurement]:
    """All metrics of a run with their errors, in the order of `METRICS`, for a robot driven by torques those of
    `LOOP_METRICS` too; all without a value when the run was cut short.

    Args:
        run: the run.
        companions: how many more precise runs of the same to simulate for the errors. 0: none, the errors stay unknown. 1:
            the difference, with a margin. 2: a still more precise one verifies that.

    Raises:
        ResultsError: a signal that the metrics need was not recorded.
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
    """The metrics of a completed run with their errors from its companions; arguments as for `measure_run`."""
    # the same run again with smaller steps and tolerance, each the companion of the one before
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

    # an error is what a companion changes, and what rounding hides
    rounding = {name: ROUNDING * _magnitude(run.recording, name) for name in measured}
    rounding["rms_acceleration_error"] += _curvature_rounding(run.recording, measured["rms_acceleration_error"].value)
    stated = {name: _stated([one.get(name) for one in results], rounding[name]) for name in measured}
    _settle(stated, run.recording, settings)
    if len(how) == 1:
        return _based(stated, f"errors are taken from a companion run with {how[0]}")
    # a second companion shows whether the first one alone understates
    missed = [name for name in stated if _is_missed([one.get(name) for one in results], rounding[name])]
    verdict = f"; one companion alone understates {', '.join(missed)}" if missed else ""
    return _based(stated, f"errors are verified by companion runs with {' and '.join(how)}{verdict}")


def _based(measured: Mapping[str, Measurement], basis: str) -> Metrics[Measurement]:
    found = Metrics(measured)
    found.basis = basis
    return found


def _stated(results: Sequence[Measurement | None], rounding: float) -> Measurement:
    """A metric with its error, from its values in the run and in ever finer ones."""
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
    """The settling time jumps by half a period where a crest just touches the band: its error is at least how far it moves
    when the vibration grows or shrinks by its own error."""
    settled, radius = stated["settling_time"], stated["residual_vibration_amplitude"].error
    if settled.error is None or radius is None:
        return
    moved = RecordedSolution(recording, settings).settling_time(radius).interpolation_error
    stated["settling_time"] = replace(settled, error=max(settled.error, moved))


def _curvature_rounding(recording: Recording, value: float | None) -> float:
    """What the rounding of positions, twice differentiated over the shortest step, adds to a root mean square."""
    steps = np.diff(recording.time)
    curvature = 8.0 * ROUNDING * _magnitude(recording, "peak_position_error") / float(steps[steps > 0.0].min()) ** 2
    return min(curvature, 0.5 * curvature**2 / value) if value else curvature


def _magnitude(recording: Recording, name: str) -> float:
    """Largest magnitude of the signals that a metric is made of; a rigid link has none."""
    columns = {"time": recording.time} | {each: column.values for each, column in recording.columns.items()}
    values = [columns[each] for each in ALL_METRICS[name].columns if each in columns]
    return max((float(np.abs(each).max()) for each in values), default=0.0)


def settings_for(run: Run) -> Settings:
    """What the metrics of a run depend on besides its recording.

    Raises:
        EquilibriumError: the end pose has no static equilibrium.
    """
    plan, band = run.plan, run.scene.cosimulation.settling_band
    return Settings(plan.task, rest_position(run), run.scene.trajectory.dwell, band, plan.joints)


def measure(recording: Recording, settings: Settings) -> Metrics[Measurement]:
    """All metrics of a complete recording, in the order of `METRICS` and `LOOP_METRICS`.

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
    """A signal between communication points; see `Signal`."""

    segments: HermiteSegments

    def peak(self) -> Measurement:
        """Largest norm; its error is how much further another segment might reach, at least that of the peak's segment."""
        signal = self.segments.consistent
        largest, errors = signal.maximum_norm(), signal.error_estimate()
        reached = np.linalg.norm(signal.evaluate(np.linspace(0.0, 1.0, 2 * len(signal.control))), axis=2).max(axis=0)
        return Measurement(largest, max(float(np.max(reached + errors)) - largest, float(errors[np.argmax(reached)])))

    def root_mean_square(self, order: int = 0) -> Measurement:
        """Root of the mean squared norm of a time derivative; its error is that of the estimated deviation e from it.

        To second order e changes the root of the mean of p² by (mean of p e + half the mean of e²) / root.
        """
        signal = self.segments.consistent
        points, _ = signal.quadrature
        values, deviation = signal.evaluate(points, order), signal.deviation_estimate(points, order)
        root = math.sqrt(signal.mean_product(values, values))
        bound = math.sqrt(signal.mean_product(deviation, deviation))
        change = abs(signal.mean_product(values, deviation)) + 0.5 * bound**2
        return Measurement(root, min(change / root, bound) if root > 0.0 else bound)

    def final(self, order: int = 0) -> Measurement:
        """Norm of a time derivative at the end of the last segment, a communication point: nothing is interpolated."""
        return Measurement(float(np.linalg.norm(self.segments.right[order, -1])))

    def settling(self, band: float, uncertainty: float = 0.0) -> Measurement:
        """Time from the first segment's start after which the norm stays below ``band`` [s]; None if it never does.

        Its error is how far the last crossing moves when the vibration's amplitude changes by the interpolation error, or by
        the ``uncertainty`` where that is larger.
        """
        vibration = self.segments.consistent
        begin, stop = float(vibration.start[0]), float(vibration.end[-1])
        crossing = last_time_above(vibration.control, vibration.start, vibration.duration, band)
        if crossing is None:
            return Measurement(0.0)
        # the crossings of a slightly wider and a slightly narrower band
        near = int(np.searchsorted(vibration.end, crossing))
        error = max(float(vibration.error_estimate()[min(near, len(vibration.end) - 1)]), uncertainty)
        spread = [
            last_time_above(vibration.control, vibration.start, vibration.duration, level)
            for level in (band + error, max(band - error, 0.0))
        ]
        early, late = (begin if time is None else time for time in spread)
        return Measurement(crossing - begin if crossing < stop else None, late - early)


class NoSignal:
    """What a rigid link's deflection is: zero throughout, and exactly so; see `Signal`."""

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
        settings: the motion that was planned, and what follows it.

    Attributes:
        tracks_joints: whether the robot is driven by torques, so that its joints stray from their planned motion.
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
    """The metrics of a run, by name."""
    return Metrics({name: each.value for name, each in measure_run(run, companions=0).items()})
