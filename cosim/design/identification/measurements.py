"""Experiments: what was measured, and the simulation that belongs to it.

What a log has of positions or torques that drive the robot replaces the scene's motion: references or measured angles of both joints where
motion drives it, torques of both motors where torques do and no controller gives them. Measured angles become a smoothing spline at the
distance of their noise, which differences of sixth order show: those of a smooth motion are far smaller.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import ceil, comb, inf, pi
from pathlib import Path
from typing import Any

import numpy as np

from flexfmu.cosim.design.identification.noise import Piece
from flexfmu.cosim.engine.child_process import CALL_LIMIT
from flexfmu.cosim.engine.errors import DataWarning, InputError, ResultsError
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.sampled_slave import fmu_slave
from flexfmu.cosim.engine.hermite import hermite_derivatives
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.master.simulator import isolation, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.measured import LEAST, Log, Mapped, TimedValues, estimate_delay, read_log
from flexfmu.cosim.engine.results import Column, Recording, Selection
from flexfmu.cosim.engine.showing import UNITS
from flexfmu.cosim.engine.slave import RealArray, Slave, SlaveVariable
from flexfmu.cosim.engine.trajectory_slave import PreparedOutputs, PreparedTable
from flexfmu.cosim.experiment.planning import PLANNED_WITH, plan
from flexfmu.cosim.experiment.scene_loop import Loop
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.many.variants import NotTogetherError, SideBySide, run_variants
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, definition
from flexfmu.cosim.metrics.metrics import measuring
from flexfmu.cosim.metrics.stress import strain_gains
from flexfmu.errors import read_text
from flexfmu.fmu_build.errors import ModelError
from flexfmu.model.scene.assembly import end_effector
from flexfmu.model.scene.keys import parse_value
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.table import COLUMNS, smoothed
from flexfmu.trajectories.trajectory import Trajectory

REALS = ("Real", "Float64", "Float32")
"""Types of an FMU's real variables."""

JOINTS = ("joint1", "joint2")
REFERENCES, ANGLES, TORQUES = (
    tuple(f"{joint}.{what}" for joint in JOINTS) for what in ("reference.position", "position", "torque")
)
"""Signals of a log that can drive the robot."""

DIFFERENCES = 6
"""Order of the differences that show the noise of measured angles."""

HELD = 0.5
"""Part of a signal's changes that are jumps, from which on it counts as held."""

FINE = 1e12
"""Counts of a turn, and parts of a unit, in place of a sensor's rounding."""

SAME = 8
"""Equal values in a row from which on a sensor's rounding hides its noise."""

PARTS = 8
"""Parts of a log of which the one with the largest noise tells the encoder's."""

SMOOTH = 1e-7
"""Noise of angles, relative to their range, below which a spline goes through all of them."""

SAME_MOTION, NEAR_MOTION, ALIKE = 1.5, 0.1, 0.9
"""Deviation from the scene's own motion, in terms of the noise, below which the log is of that motion; relative to the angles' range, below
which it is nearly; and correlation above which both are compared."""

IRREGULAR, GAP = 0.02, 1.5
"""Scatter of the sample distances that is told, and distance above which samples are missing, in terms of the usual one."""

CURRENTS = tuple(f"{joint}.current" for joint in JOINTS)

STRAIN = re.compile(r"(link[12][12])\.strain\[([0-9.]+)\]")
"""Strain of an outer fibre, at a distance from the link's base relative to its length."""


@dataclass(frozen=True, eq=False)
class Channel:
    """A measured signal.

    Attributes:
        name: of the simulated signal.
        unit: in SI.
        parts: outputs that it is the weighted sum of, with their factors.
        time: (N,) instants of the log [s], or what its axis says.
        values: (N,) finite values.
        pieces: samples between gaps.
        step: usual distance of the samples [s].
        part: 1 or -1j, for the real or the imaginary part of a frequency response, or 1 for modes; None for signals over time and metrics.
        errors: (N,) standard errors of the values, up to a factor; None for equal ones.
        least: smallest factor; 1 for errors that are certain.
        axis: label of the time.
    """

    name: str
    unit: str
    parts: Mapping[str, float]
    time: RealArray = field(repr=False)
    values: RealArray = field(repr=False)
    pieces: tuple[Piece, ...] = field(repr=False)
    step: float
    part: complex | None = None
    errors: RealArray | None = field(default=None, repr=False)
    least: float = 0.0
    axis: str = "time [s]"

    @property
    def kind(self) -> str:
        """What is measured, ``torque`` for example: such sensors have a common delay."""
        if self.part is not None:
            return "response"
        words = re.sub(r"\[.*?\]", "", self.name).split(".")
        return words[-2] if words[-1] in ("x", "y") and len(words) > 2 else words[-1]

    @property
    def sensor(self) -> str:
        """What has a gain: the signal, or both parts of a response."""
        return self.name if self.part is None else self.name.rpartition(" ")[0]

    def simulated(self, recording: Recording, delay: float) -> tuple[RealArray, RealArray]:
        """Return the signal that is simulated with a delay [s], and its derivative by the negative delay (N,); over samples for a held one."""
        if self.part is not None:
            turn = -2j * pi * self.time
            (value,) = (self.part * recording[each].values * np.exp(turn * delay) for each in self.parts)
            return value.real, -(turn * value).real
        value, slope = self._at(recording, self.time - delay)
        changes = np.abs(sum(factor * np.diff(recording[key].values) for key, factor in self.parts.items()))
        if changes[np.diff(recording.time) == 0.0].sum() > HELD * changes.sum() > 0.0:
            later, earlier = (self._at(recording, self.time - delay + shift)[0] for shift in (self.step, -self.step))
            slope = (later - earlier) / (2.0 * self.step)
        return value, slope

    def _at(self, recording: Recording, time: RealArray) -> RealArray:
        """The signal and its time derivative (2, N)."""
        parts = [factor * sampled(recording.time, recording[key], time) for key, factor in self.parts.items()]
        return np.asarray(sum(parts))


def sampled(points: RealArray, column: Column, time: RealArray) -> RealArray:
    """Return a recorded signal and its derivative (2, N) at any instants, right limits at jumps; beyond the ends it is constant.

    Between the points (M,) it is the Hermite polynomial through the recorded derivatives.
    """
    known = [each for each in (column.values, column.first, column.second) if each is not None]
    inside = np.clip(time, points[0], points[-1])
    last = np.clip(np.searchsorted(points, inside, "right") - 1, 0, points.size - 2)
    # a jump at the end has no step behind it
    last = np.where(points[last + 1] > points[last], last, last - 1)
    width, elapsed = points[last + 1] - points[last], inside - points[last]
    both = np.array(known)
    polynomial = hermite_derivatives(both[:, last], both[:, last + 1], width)
    found, power = np.zeros((2, time.size)), np.ones(time.size)
    for order, each in enumerate(polynomial):
        found[0] += each * power
        if order + 1 < len(polynomial):
            found[1] += polynomial[order + 1] * power
        power *= elapsed / (order + 1)
    found[1, time != inside] = 0.0
    return found


@dataclass(frozen=True, eq=False)
class Experiment:
    """A log, and the simulation that belongs to it.

    Attributes:
        name: of the log.
        channels: the signals that are compared.
        simulate: parameters of each variant → its recording.
        stop_time: end of the simulation [s].
        has_clock: whether the log drives the simulation, whose time is then that of the log.
        scene: the scene that is simulated; None for an FMU.
        motion: instants (N,) [s] → what residuals may depend on (N, k): the joints' velocities, their signs and accelerations; None where the
            motion isn't known before.
        start: parameter of the FMU → value and standard deviation of where the simulation begins, as far as the log tells.
        drive: signals of the log that drive the simulation with their noise; None for none.
        is_table: whether rows are runs or modes, for which there are no sensors.
        is_together: whether variants are simulated side by side, so that some more cost little.
    """

    name: str
    channels: tuple[Channel, ...]
    simulate: Callable[[Sequence[Mapping[str, float]]], list[Recording]]
    stop_time: float
    has_clock: bool
    scene: Scene | None = None
    motion: Callable[[RealArray], RealArray] | None = None
    is_table: bool = False
    is_together: bool = False
    start: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    drive: LoggedSignals | None = None

    @property
    def is_response(self) -> bool:
        """Whether it is a frequency response."""
        return not self.is_table and self.channels[0].part is not None


class LoggedSignals(PreparedOutputs):
    """Signals of a log as outputs of a slave: a cubic spline, whose values and slopes at communication points are met exactly.

    Args:
        name: of the slave.
        units: name of an output → unit.
        time: (N,) instants [s], ascending.
        values: (n, N) values of the outputs.

    Attributes:
        noise: (n,) standard deviation of the values' own white noise.
    """

    announced_order, max_output_order, ends_exactly = 3, 3, True
    breakpoints: Sequence[float] = ()

    def __init__(self, name: str, units: Mapping[str, str], time: RealArray, values: RealArray) -> None:
        self.name, self._end = name, float(time[-1])
        self._time, self._values = time, values
        self.noise = np.array([noise_of(each) for each in values])
        self.disturb(None)
        self.variables = tuple(SlaveVariable(each, "output", unit) for each, unit in units.items())
        self.prepare(time[:1])

    def disturb(self, rng: np.random.Generator | None) -> None:
        """Add as much noise again in the next runs; None for no more."""
        from scipy.interpolate import CubicSpline

        added = 0.0 if rng is None else self.noise[:, None] * rng.normal(size=self._values.shape)
        self._spline = CubicSpline(self._time, self._values + added, axis=1, bc_type="natural")

    def prepare(self, times: RealArray) -> None:
        """Tabulate values and slopes at communication points (N,) [s]."""
        known = np.stack([self._spline(np.minimum(times, self._end), order) for order in range(2)])
        known[1, :, times > self._end] = 0.0
        found = np.zeros((4, *known.shape[1:]))
        found[:2] = known
        if times.size > 1:
            found[:, :, :-1] = hermite_derivatives(known[..., :-1], known[..., 1:], np.diff(times))
        polynomials = np.ascontiguousarray(found.transpose(2, 0, 1))
        self._table = PreparedTable(times, polynomials, polynomials)
        self._begin()


def by_motion(
    variants: Sequence[Mapping[str, float]],
) -> Iterator[tuple[dict[str, float], list[int], list[dict[str, float]]]]:
    """Yield what the motion depends on, as keys of the scene, the places of the variants that have it in common, and their other parameters."""
    groups: dict[tuple[tuple[str, float], ...], list[int]] = {}
    for i, each in enumerate(variants):
        groups.setdefault(tuple((k, v) for k, v in each.items() if k in PLANNED_WITH), []).append(i)
    for planned, members in groups.items():
        rest = [{k: v for k, v in variants[i].items() if k not in PLANNED_WITH} for i in members]
        yield {f"mechanism.{key}": value for key, value in planned}, members, rest


DWELL = 0.05
"""Standstill that is simulated after a motion from a log [s], for negative delays."""


class SceneSimulation:
    """Simulates variants of a scene: side by side where the motion alone drives the robot, else one after the other.

    Args:
        scene: the scene.
        fmu_path: its FMU.
        outputs: what is recorded.
        loop: motion and slaves instead of the scene's; None for these.
        stop_time: end of the simulation [s]; None for that of motion and dwell.
    """

    def __init__(
        self,
        scene: Scene,
        fmu_path: Path,
        outputs: Sequence[str],
        loop: Loop | None = None,
        stop_time: float | None = None,
    ) -> None:
        self._scene, self._fmu_path, self._outputs = scene, fmu_path, [*outputs]
        self._loop, self._stop_time = loop, stop_time
        self._together: SideBySide | None = None
        self._alone: PreparedScene | None = None
        self._is_alone = loop is not None

    def __call__(self, variants: Sequence[Mapping[str, float]]) -> list[Recording]:
        """Return the recording of each variant: name of an FMU parameter → value.

        Raises:
            ResultsError: a run failed.
            InputError: a value is out of range.
        """
        found: dict[int, Recording] = {}
        for planned, members, rest in by_motion(variants):
            simulation = self
            if planned:
                scene = self._scene.replace(planned)
                simulation = SceneSimulation(scene, self._fmu_path, self._outputs, self._loop, self._stop_time)
            found |= zip(members, simulation._runs(rest), strict=True)
        return [found[i] for i in range(len(variants))]

    def _runs(self, variants: Sequence[Mapping[str, float]]) -> list[Recording]:
        found: list[Recording | None] = [None] * len(variants)
        if not self._is_alone:
            try:
                self._together = self._together or SideBySide(self._scene, self._fmu_path)
                runs = [*self._together.runs(variants, self._outputs)]
                found = [None if run is None else run.recording for run in runs]
            except (NotTogetherError, ModelError):
                self._is_alone = True
        return [each or self._one(variant) for each, variant in zip(found, variants, strict=True)]

    def _one(self, variant: Mapping[str, float]) -> Recording:
        if self._alone is None:
            record = Selection(self._outputs, order=2)
            self._alone = PreparedScene(self._scene, loop=self._loop, fmu_path=self._fmu_path, record=record)
            if self._stop_time is not None:
                self._alone.stop_time = self._stop_time
        run = self._alone.run(variant)
        check_end(run.completed, self._scene.name, variant, run.message)
        return run.recording


def check_end(completed: bool, model: str, variant: Mapping[str, float], message: str) -> None:
    """Check that a variant's run came to its end.

    Raises:
        ResultsError: it didn't.
    """
    if not completed:
        where = ", ".join(f"{name} = {value:g}" for name, value in variant.items())
        raise ResultsError(f"{model} can't be simulated with {where}: {message}")


def comparable(scene: Scene, fmu_path: Path) -> dict[str, str]:
    """Name → unit of all signals of a log that can be used: outputs of the FMU, what drives it, and currents of the motors."""
    variables = open_fmu(fmu_path).description.modelVariables
    found = {each.name: each.unit or "" for each in variables if each.causality == "output" and each.type == "Real"}
    found |= dict.fromkeys((*REFERENCES, *ANGLES), "rad") | dict.fromkeys(TORQUES, "N.m")
    if scene.motor is not None and scene.motor.torque_constant is not None:
        found |= dict.fromkeys(CURRENTS, "A")
    return found


def parts_of(name: str, scene: Scene, outputs: Mapping[str, str]) -> dict[str, float]:
    """Outputs that a signal is the weighted sum of, with their factors.

    Raises:
        InputError: the scene has no such signal.
    """
    if strain := STRAIN.fullmatch(name):
        return strain_gains(scene, strain[1], float(strain[2]))
    if name.endswith(".current"):
        joint = JOINTS.index(name.partition(".")[0])
        assert scene.motor is not None
        motor = scene.motor.of_joint(joint)
        if motor.gear_efficiency != 1.0 or not motor.torque_constant:
            raise InputError(
                f"{name}: currents are taken in proportion to torques, but the gear has an efficiency of {motor.gear_efficiency:g}: map "
                "the column to the torque, with the factor from A to N.m that holds"
            )
        return {TORQUES[joint]: 1.0 / (motor.torque_constant * motor.gear_ratio)}
    return {name: 1.0}


def scene_experiment(
    scene: Scene,
    fmu_path: Path,
    log: Log,
    mapping: Mapping[str, Mapped],
    folder: str,
    segments: Sequence[tuple[float, float]] = (),
    *,
    name: str,
    strict: bool = False,
) -> Experiment:
    """Return the experiment of a log with a scene.

    Args:
        scene: the scene, with what belongs to this log alone: its payload, or its motion.
        fmu_path: FMU with the scene's effects.
        log: as for `read_log`.
        mapping: column → what it is.
        folder: for motions from logs, as long as the experiment lives.
        segments: intervals of the log's time whose samples are compared [s]; none for all.
        name: of the log, for messages.
        strict: as for `read_log`.

    Raises:
        InputError, SignalFileError: the log can't be used; the message says why.
    """
    known = comparable(scene, fmu_path)
    strains = {each.signal: "1" for each in mapping.values() if STRAIN.fullmatch(each.signal)}
    recording = once(read_log(log, mapping, known | strains, strict=strict), name)
    start, stop_time, loop, pose, source = 0.0, None, None, dict[str, tuple[float, float]](), None
    drive, driving = scene.cosimulation.drive, tuple[str, ...]()
    for pair in (REFERENCES, ANGLES) if drive == "motion" or scene.controller else ():
        if all(each in recording for each in pair) and (pair is REFERENCES or drive == "motion"):
            scene, start = with_motion(scene, recording, pair, Path(folder), name)
            driving = pair
            break
    if drive == "torque" and not scene.controller and all(each in recording for each in TORQUES):
        loop, start, stop_time, pose, source = replayed(scene, recording, name)
        driving = TORQUES
    apart = (*driving, *REFERENCES, *(ANGLES if drive == "motion" else ()))
    compared = [each for each in recording.columns if each not in apart]
    if not compared:
        raise InputError(
            f"{name} has nothing to compare: {', '.join(recording.columns)} "
            f"{'drive the robot' if driving else 'are no outputs of it'}; map a column to one of "
            f"{', '.join(sorted(set(known) - {*driving, *REFERENCES, *ANGLES}))}"
        )
    scene = with_exact_sensors(scene)
    channels = tuple(channel(recording, each, parts_of(each, scene, known), start, segments, name) for each in compared)
    outputs = sorted({output for each in channels for output in each.parts})
    simulate = SceneSimulation(scene, fmu_path, outputs, loop, stop_time)
    if stop_time is not None:
        return Experiment(name, channels, simulate, stop_time, bool(driving), scene, start=pose, drive=source)
    planned = plan(scene)

    def motion(time: RealArray) -> RealArray:
        _, velocity, acceleration = planned.joints.evaluate(time, 2)
        slow = 0.01 * float(abs(velocity).max(initial=0.0)) or 1.0
        return np.hstack([velocity, np.tanh(velocity / slow), acceleration])

    together = drive == "motion"
    return Experiment(name, channels, simulate, planned.stop_time, bool(driving), scene, motion, is_together=together)


EXACT = {"counts_per_turn": FINE, "resolution": 1.0 / FINE, "standard_deviation": 0.0, "half_width": 0.0}
"""Keys of sensors → values without rounding and noise."""


def with_exact_sensors(scene: Scene) -> Scene:
    """The scene without rounding and noise of its sensors: those of the log are other ones, and rounding in a loop makes results rough."""
    changes: dict[str, Any] = {}
    for place, each in enumerate(scene.imperfection):
        for key, value in EXACT.items():
            if getattr(each, key, None) is not None:
                changes[f"imperfection[{place}].{key}"] = value
    return scene.replace(changes) if changes else scene


def once(recording: Recording, name: str) -> Recording:
    """The recording with each instant once: of repeated ones the last, which is told."""
    repeated = np.append(np.diff(recording.time) == 0.0, False)
    if not repeated.any():
        return recording
    at = recording.time[np.argmax(repeated)]
    text = f"{name}: {np.count_nonzero(repeated)} instants are repeated, {at:g} s first; the last row of each is taken"
    warnings.warn(text, DataWarning, stacklevel=2)
    columns = {key: Column(each.unit, each.values[~repeated]) for key, each in recording.items()}
    return Recording(recording.time[~repeated], columns)


def channel(
    recording: Recording,
    signal: str,
    parts: Mapping[str, float],
    start: float,
    segments: Sequence[tuple[float, float]],
    name: str,
) -> Channel:
    """Return a measured signal without what is missing; its time begins at ``start`` [s] of the log.

    Raises:
        InputError: it has too few values, or no segment has any.
    """
    column = recording[signal]
    known = np.isfinite(column.values)
    if segments:
        known &= np.any([(recording.time >= a) & (recording.time <= b) for a, b in segments], axis=0)
    time, values = recording.time[known], column.values[known]
    if time.size < LEAST:
        where = " in the segments" if segments else ""
        ends = f"the log goes from {recording.time[0]:g} to {recording.time[-1]:g} s"
        raise InputError(
            f"{name}: {signal} has {time.size} values{where}, at least {LEAST} are needed: {ends}; give a longer "
            f"{'segment' if segments else 'one'}, or leave the column out"
        )
    step = float(np.median(np.diff(time)))
    distinct = _distinct(values)
    if np.count_nonzero(distinct) >= LEAST:
        time, values = time[distinct], values[distinct]
    steps = np.diff(time)
    breaks = np.flatnonzero(steps > GAP * step) + 1
    within = steps[steps <= GAP * step]
    if within.size and float(np.abs(within - step).max()) > IRREGULAR * step:
        scatter = 100.0 * float(np.abs(within - step).max()) / step
        text = f"{name}: distances of samples scatter by {scatter:.2g} %; noise is described as if they were equal"
        warnings.warn(text, DataWarning, stacklevel=2)
    edges = [0, *breaks.tolist(), time.size]
    pieces = tuple(slice(a, b) for a, b in pairwise(edges))
    return Channel(signal, column.unit, parts, time - start, values, pieces, step)


def _distinct(values: RealArray) -> np.ndarray:
    """Which values (N,) are kept: of `SAME` equal ones in a row, or more, the middle one, since their rounding is one error, not many."""
    ends = np.flatnonzero(np.diff(values, prepend=np.nan, append=np.nan) != 0.0)
    begin, length = ends[:-1], np.diff(ends)
    kept = np.repeat(length < SAME, length)
    kept[begin + length // 2] = True
    return kept


def noise_of(values: RealArray) -> float:
    """Standard deviation of the white noise of equally spaced values of something smooth, rounding included."""
    if values.size <= DIFFERENCES:
        return 0.0
    differences = np.diff(values, n=DIFFERENCES)
    return float(np.sqrt(np.mean(differences**2) / comb(2 * DIFFERENCES, DIFFERENCES)))


def with_motion(
    scene: Scene, recording: Recording, pair: Sequence[str], folder: Path, name: str
) -> tuple[Scene, float]:
    """The scene with the motion of a log, and the log's time where that begins [s].

    Raises:
        InputError: the log has gaps there, or the motion isn't one that the robot can make.
    """
    angles = np.array([recording[each].values for each in pair])
    known = np.isfinite(angles).all(axis=0)
    time, angles = recording.time[known], angles[:, known]
    steps = np.diff(time)
    if time.size < LEAST or float(steps.max()) > 2.0 * GAP * float(np.median(steps)):
        gap = "" if time.size < LEAST else f", and none for {steps.max():.3g} s from {time[np.argmax(steps)]:g} s on"
        raise InputError(
            f"{name}: {pair[0]} and {pair[1]} drive the robot, but have {time.size} values{gap}: cut the log there"
        )
    noise = max(noise_of(each) for each in angles)
    smooths = noise > SMOOTH * float(np.ptp(angles))
    columns = {"time": time - time[0], **dict(zip(COLUMNS["joints"][0], angles, strict=True))}
    # of the scene's own motion the deviation alone is smoothed, if there is any
    planned = plan(scene)
    late = _lateness(planned.joints, planned.stop_time, time, angles)
    if late is not None:
        own = planned.joints.evaluate(time - late, 3)
        deviation = angles.T - own[0]
        if float(np.sqrt(np.mean(deviation**2))) < SAME_MOTION * noise:
            return scene, late
        if smooths and float(np.sqrt(np.mean(deviation**2))) < NEAR_MOTION * float(np.ptp(angles)):
            jets = own + smoothed(time - time[0], deviation, noise, 5, "joints").evaluate(time - time[0], 3)
            jets[1:, [0, -1]] = 0.0
            pairs = [
                (key, jets[order, :, k]) for order, keys in enumerate(COLUMNS["joints"]) for k, key in enumerate(keys)
            ]
            columns, smooths = {"time": time - time[0], **dict(pairs)}, False
    path = folder / f"motion{len([*folder.iterdir()])}.csv"
    np.savetxt(path, np.column_stack([*columns.values()]), "%.17g", ",", header=",".join(columns), comments="")
    motion: dict[str, Any] = {"kind": "table", "file": str(path), "dwell": DWELL} | (
        {"noise": noise} if smooths else {}
    )
    try:
        driven = scene.replace({"trajectory": motion})
        plan(driven)
    except (TrajectoryError, InputError) as error:
        text = re.sub(rf"{re.escape(str(path))}(, line \d+(, column \w+)?)?:? ?", "", str(error))
        raise InputError(
            f"{name}: the angles of {pair[0]} and {pair[1]} are no motion of {scene.name}: {text}"
        ) from None
    return driven, float(time[0])


def _lateness(joints: Trajectory, end: float, time: RealArray, angles: RealArray) -> float | None:
    """The log's time at which a motion begins in measured angles [s]; None where they are of another motion."""
    grid = np.linspace(0.0, end, 2000)
    own = joints.evaluate(grid, 0)[0].T
    pairs = [(TimedValues(time, a), TimedValues(grid, b)) for a, b in zip(angles, own, strict=True)]
    try:
        found = estimate_delay(pairs)
    except InputError:
        return None
    return found.seconds if found.correlation > ALIKE else None


def replayed(
    scene: Scene, recording: Recording, name: str
) -> tuple[Loop, float, float, dict[str, tuple[float, float]], LoggedSignals]:
    """The loop in which the torques of a log drive the robot, the log's time where it begins, the simulation's end [s], and `start` and `drive`
    of the experiment.

    Raises:
        InputError: torques are missing, or the robot can't stand where the log begins.
    """
    torques = np.array([recording[each].values for each in TORQUES])
    known = np.isfinite(torques).all(axis=0)
    time, torques = recording.time[known], torques[:, known]
    if time.size < LEAST:
        raise InputError(f"{name}: {TORQUES[0]} and {TORQUES[1]} drive the robot, but have {time.size} values")
    begin, end = float(time[0]), float(time[-1])
    source = LoggedSignals("replay", dict.fromkeys(TORQUES, "N.m"), time - begin, torques)
    pose = dict[str, tuple[float, float]]()
    if all(each in recording for each in ANGLES):
        angles = [values[np.isfinite(values)] for values in (recording[each].values for each in ANGLES)]
        # rounding hardly shows at rest
        noise = [max(noise_of(part) for part in np.array_split(each, PARTS)) for each in angles]
        first = [float(each[0]) for each in angles]
        try:
            ends = [
                end_effector(scene.mechanism, (first[0] + one * noise[0], first[1] + other * noise[1]))
                for one, other in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
            ]
        except ValueError as error:
            raise InputError(f"{name}: the robot can't stand at the angles where the log begins: {error}") from None
        deviations = np.linalg.norm(np.subtract(ends[1:], ends[0]), axis=0).tolist()
        pose = {
            key: (x, deviation) for key, x, deviation in zip(("start.x", "start.y"), ends[0], deviations, strict=True)
        }
    motion = plan(scene)
    loop = Loop(motion, motion.joints, controllers=(source,), parameters={key: x for key, (x, _) in pose.items()})
    step, uncertain = scene.cosimulation.communication_step, {key: each for key, each in pose.items() if each[1] > 0.0}
    return loop, begin, step * int((end - begin) / step), uncertain, source


def fmu_experiment(
    path: Path,
    log: Log,
    mapping: Mapping[str, Mapped],
    segments: Sequence[tuple[float, float]] = (),
    *,
    name: str,
    step: float | None = None,
    tolerance: float | None = None,
    strict: bool = False,
) -> Experiment:
    """Return the experiment of a log with an FMU: columns named like inputs drive it, others named like its variables are compared.

    Args:
        path: of the FMU.
        step: communication step [s]; None for the FMU's own, and at most the log's.
        tolerance: relative tolerance; None for the FMU's own.
        log, mapping, segments, name, strict: as for `scene_experiment`.

    Raises:
        InputError, SignalFileError: the log or the FMU can't be used; the message says why.
    """
    description = open_fmu(path).description
    reals = [each for each in description.modelVariables if each.type in REALS]
    known = {each.name: each.unit or "" for each in reals if each.causality in ("input", "output", "local")}
    entries = {each.name for each in reals if each.causality == "input"}
    recording = once(read_log(log, mapping, known, strict=strict), name)
    driving, compared = ([key for key in recording.columns if (key in entries) == wanted] for wanted in (True, False))
    if not compared:
        raise InputError(
            f"{name} has inputs of {path.name} alone: map a column to one of {', '.join(sorted(set(known) - entries))}"
        )
    start, end = float(recording.time[0]), float(recording.time[-1])
    channels = tuple(channel(recording, each, {each: 1.0}, start, segments, name) for each in compared)
    inputs = None
    if driving:
        rows = np.array([recording[key].values for key in driving])
        whole = np.isfinite(rows).all(axis=0)
        units = {key: recording[key].unit for key in driving}
        inputs = LoggedSignals("log", units, recording.time[whole] - start, rows[:, whole])
    # the FMU's own step, but none longer than the samples' distance
    own = getattr(description.defaultExperiment, "stepSize", None)
    chosen = step or min(float(own or inf), *(each.step for each in channels))
    # a whole number of steps
    duration, count = end - start, ceil((end - start) / chosen * (1.0 - 1e-9))
    record = Selection([f"model.{each}" for each in compared], order=2)

    def simulated(variant: Mapping[str, float]) -> Recording:
        slaves: list[Slave] = [fmu_slave(path, "model", dict(variant)), *([] if inputs is None else [inputs])]
        run = simulate(
            connect(slaves, [(f"log.{key}", f"model.{key}") for key in driving]),
            duration,
            duration / count,
            tolerance=tolerance,
            record=record,
            isolation=isolation(None, slaves, CALL_LIMIT, caller_owned=False),
        )
        check_end(run.outcome is Outcome.COMPLETED, path.name, variant, run.message)
        return Recording(run.recording.time, {key.removeprefix("model."): each for key, each in run.recording.items()})

    return Experiment(name, channels, lambda variants: [*map(simulated, variants)], duration, True, drive=inputs)


def is_table(log: Log) -> bool:
    """Whether a log is a table of metrics: a CSV file without a time, whose columns are metrics and keys of the scene."""
    if not isinstance(log, str | Path) or Path(log).suffix != ".csv" or not Path(log).is_file():
        return False
    names = names_in(Path(log))
    return "time" not in names and "t" not in names and any(each in ALL_METRICS for each in names)


def names_in(path: Path) -> set[str]:
    """Names of the columns of a CSV file, without units and what else stands behind a blank."""
    header = next((each for each in read_text(path).splitlines() if each.strip() and not each.startswith("#")), "")
    return {each.strip().strip('"').partition(" ")[0] for each in re.split("[,;\t]", header)}


def table_experiment(scene: Scene, path: Path, name: str) -> Experiment:
    """Return the experiment of a table of metrics: a row for each run, keys of the scene and metrics, with their units in brackets, as columns.

    The rows' numbers take the place of the time.

    Args:
        scene: the scene.
        path: of the CSV file.
        name: of the table, for messages.

    Raises:
        InputError: a cell isn't a value, or there are too few rows.
    """
    header, *rows = csv.reader(
        line for line in read_text(path).splitlines() if line.strip() and not line.startswith("#")
    )
    columns = [re.fullmatch(r"\s*(\S+?)\s*(?:\[(.*)\])?\s*", each) for each in header]
    if not all(columns) or any(len(row) != len(header) for row in rows):
        raise InputError(f"{name}: every row needs a cell for each of the columns {', '.join(header)}")
    names = [(each[1], each[2]) for each in columns if each is not None]
    changes = [
        {key: parse_value(cell, key) for (key, _), cell in zip(names, row, strict=True) if key not in ALL_METRICS}
        for row in rows
    ]
    place, channels = np.arange(len(rows), dtype=float), list[Channel]()
    for column, (metric, unit) in enumerate(names):
        if metric not in ALL_METRICS:
            continue
        try:
            values = np.array([float(row[column]) for row in rows]) * (UNITS[unit][1] if unit else 1.0)
        except (ValueError, KeyError) as error:
            raise InputError(
                f"{name}: column {header[column]!r} has {error} where a number or a known unit is needed"
            ) from None
        pieces = tuple(slice(k, k + 1) for k in range(len(rows)))
        channels.append(Channel(metric, definition(metric).unit, {metric: 1.0}, place, values, pieces, 1.0, axis="row"))
    measured = [each.name for each in channels]

    def simulate(variants: Sequence[Mapping[str, float]]) -> list[Recording]:
        found: dict[int, Recording] = {}
        for planned, members, rest in by_motion(variants):
            robot = scene.replace(planned) if planned else scene
            results = run_variants(robot, [{**row, **each} for each in rest for row in changes], measuring(measured))
            if failed := next((each for each in results if each.error is not None), None):
                raise ResultsError(f"{name}: {failed.changes} can't be simulated: {failed.error}")
            table = np.array([[each.value[key] for key in measured] for each in results if each.value], dtype=float)
            for i, block in zip(members, table.reshape(-1, len(rows), len(measured)), strict=True):
                columns = zip(measured, block.T, strict=True)
                found[i] = Recording(place, {key: Column(definition(key).unit, each) for key, each in columns})
        return [found[i] for i in range(len(variants))]

    return Experiment(name, tuple(channels), simulate, 2.0 * len(rows), True, scene, is_table=True)
