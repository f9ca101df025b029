"""Designs input shapers for a scene and co-simulates it with each of them and each payload error.

Shapers are designed for the robot's vibration modes along the path and over a payload band. All runs share one FMU, whose payload is a
parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from flexfmu.cosim.control.sections import with_payload_error
from flexfmu.cosim.engine.errors import CosimError, InputError
from flexfmu.cosim.experiment.planning import APPLICATIONS, MotionPlan, plan
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.metrics import measure, settings_for
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import damped_modes
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.shapers.designs import SHAPERS, design, specified_insensitivity
from flexfmu.trajectories.shapers.sequence import UNSHAPED, ImpulseSequence, Oscillator
from flexfmu.trajectories.trajectory import TaskTrajectory

POSES = 11
"""Number of poses at which the modes are calculated: at equal intervals of time along the path, both ends included."""

NEIGHBOURHOOD = 3.0
"""Shapers are designed for modes up to this multiple of the lowest frequency; a motion hardly excites higher ones."""

MOST_MODES = 3
"""Largest number of modes that a shaper is designed for; a zero-vibration shaper adds half a period for each."""

WIDEST = 2.2
"""Largest ratio of the highest to the lowest frequency of a specified-insensitivity shaper's band."""

CONVOLVED = ("um-zv", "zv", "zvd")
"""Shapers that are convolved for several modes; longer ones would add too much time."""

UNSHAPED_NAME, NOTHING = "unshaped", "-"
"""Name and application of the unshaped motion."""

DWELL_PERIODS = 15.0
"""Dwell in periods of the lowest mode for a scene without dwell, so that residual vibration can be measured."""


JERK_POINTS = 2001
"""Number of instants at which the jerk of a motion is evaluated, besides its breakpoints."""

MEASURED = ("residual_vibration_amplitude", "settling_time", "peak_torque_1", "peak_torque_2")
"""Metrics of each trial."""

SMOOTH = 1e-6
"""Jump of the acceleration relative to its maximum below which it is rounding."""

Drive = Literal["perfect", "controller"]
"""Drive of the robot in a study: motors that follow their references exactly, or the scene's controllers."""


@dataclass(frozen=True)
class DesignModes:
    """The modes and frequency bands that the shapers are designed for.

    Attributes:
        modes: modes at the end pose, where the residual vibration occurs, with the scene's payload; lowest first.
        path_range: lowest and highest frequency of the first mode along the path [Hz].
        band: lowest frequency of the first and highest of the last mode at the end pose over the payload band [Hz].
        first_band: lowest and highest frequency of the first mode at the end pose over the payload band [Hz].
    """

    modes: tuple[Oscillator, ...]
    path_range: tuple[float, float]
    band: tuple[float, float]
    first_band: tuple[float, float]


@dataclass(frozen=True)
class Alternative:
    """A shaper designed for the scene.

    Attributes:
        name: short name.
        sequence: its impulses.
        section: its keys in the scene file's `[[shaper]]` table, without `apply`.
    """

    name: str
    sequence: ImpulseSequence
    section: Mapping[str, Any] = field(default_factory=dict)


def design_modes(motion: MotionPlan, payload_errors: Iterable[float]) -> DesignModes:
    """Return the modes at the end of a motion, and their frequency bands along the path and over the payload errors.

    Args:
        motion: a scene's motion.
        payload_errors: relative errors of the payload's mass.

    Raises:
        InputError: nothing vibrates.
        EquilibriumError: the robot has no stable equilibrium at a pose.
    """
    # modes along the path, and at the end pose with each payload error
    poses = motion.joints.evaluate(np.linspace(0.0, motion.duration, POSES), 0)[0]
    found = [damped_modes(motion.scene, pose) for pose in poses]
    if not len(found[-1].frequencies):
        raise InputError(
            f"nothing vibrates in scene {motion.scene.name}: all links are rigid or overdamped, and there is nothing to shape for; "
            "give `effects` some modes, such as proximal_bending = 3"
        )
    # the lowest modes near the lowest one
    pairs = zip(found[-1].frequencies[:MOST_MODES].tolist(), found[-1].ratios[:MOST_MODES].tolist(), strict=True)
    lowest = found[-1].frequencies[0]
    modes = tuple(Oscillator(*pair) for pair in pairs if pair[0] <= NEIGHBOURHOOD * lowest)
    varied = [damped_modes(with_payload_error(motion.scene, error), poses[-1]) for error in payload_errors]
    ends = [found[-1], *varied]
    # frequency bands
    last = len(modes) - 1
    first = [float(each.frequencies[0]) for each in ends]
    highest = max(float(each.frequencies[min(last, len(each.frequencies) - 1)]) for each in ends)
    along = [float(each.frequencies[0]) for each in found if len(each.frequencies)]
    return DesignModes(modes, (min(along), max(along)), (min(first), highest), (min(first), max(first)))


def alternatives(design_for: DesignModes) -> list[Alternative]:
    """Return shapers for the first mode, `CONVOLVED` ones for all modes, and SI for the frequency band, by duration.

    SI covers all modes, or where their band is wider than `WIDEST` the first mode alone. A shaper that doesn't exist
    for a mode's damping is left out.
    """
    modes = design_for.modes
    candidates = [(name, modes[:1]) for name in SHAPERS]
    if len(modes) > 1:
        candidates += [(name, modes) for name in CONVOLVED]
    found = []
    for name, chosen in candidates:
        with suppress(TrajectoryError):  # too much damping for this kind
            section = {"kind": name, "modes": [{"frequency": each.frequency, "ratio": each.ratio} for each in chosen]}
            found.append(Alternative(" x ".join([name] * len(chosen)), design(name, chosen), section))
    band = design_for.band if design_for.band[1] <= WIDEST * design_for.band[0] else design_for.first_band
    with suppress(TrajectoryError):  # the band is too wide
        insensitive = {"kind": "si", "band": list(band), "ratio": modes[0].ratio}
        found.append(Alternative("si", specified_insensitivity(*band, ratio=modes[0].ratio), insensitive))
    return sorted(found, key=lambda each: each.sequence.duration)


@dataclass(frozen=True)
class PayloadTrial:
    """Results of one co-simulation.

    Attributes:
        payload_error: relative error of the payload's mass.
        residual: largest distance of the end effector from where it comes to rest during the dwell [m]: from its
            equilibrium with a perfect drive, from its last position with a controller.
        settling_time: time after the motion's end from which it stays in the settling band [s]; None if it doesn't
            settle within the dwell.
        peak_torque: largest torque of either motor over the motion [N.m].
        rest_offset: distance of a controlled robot's last position from the equilibrium [m]; 0 with a perfect drive.
    """

    payload_error: float
    residual: float
    settling_time: float | None
    peak_torque: float
    rest_offset: float = 0.0


@dataclass(frozen=True)
class ShapedMotion:
    """A motion shaped on the joints or along the path, or the unshaped motion.

    Attributes:
        name: of the shaper.
        application: ``joints`` or ``path``; ``-`` for none.
        sequence: its impulses.
        motion: the shaped motion.
        section: the scene file's `[[shaper]]` table that applies it; empty for the unshaped motion.
    """

    name: str
    application: str
    sequence: ImpulseSequence
    motion: MotionPlan
    section: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Name and application, such as ``zv on path``."""
        return self.name if self.application == NOTHING else f"{self.name} on {self.application}"


@dataclass(frozen=True)
class CandidateResult:
    """Results of a candidate over all payload errors.

    Attributes:
        candidate: the simulated candidate.
        added_time: duration of the motion minus that of the scene's own motion [s].
        path_deviation: largest distance of the rigid end effector from the scene's path [m].
        trials: one for each payload error.
        peak_jerk: largest third derivative of a joint reference [rad/s3]; infinite where an acceleration jumps.
    """

    candidate: ShapedMotion
    added_time: float
    path_deviation: float
    trials: tuple[PayloadTrial, ...]
    peak_jerk: float = np.inf

    @cached_property
    def nominal(self) -> PayloadTrial:
        """The trial with the scene's own payload."""
        return min(self.trials, key=lambda trial: abs(trial.payload_error))

    @property
    def worst_residual(self) -> float:
        """Largest residual vibration over the payload band [m]."""
        return max(trial.residual for trial in self.trials)

    @property
    def peak_torque(self) -> float:
        """Largest torque of either motor over the payload band [N.m]."""
        return max(trial.peak_torque for trial in self.trials)

    @property
    def time_to_rest(self) -> float | None:
        """Time from the unshaped motion's end to rest [s], the longest over the payload band; None where one trial didn't settle."""
        times = [trial.settling_time for trial in self.trials if trial.settling_time is not None]
        return self.added_time + max(times) if len(times) == len(self.trials) else None


def studied(scene: Scene, lowest_frequency: float, drive: Drive | None = None) -> Scene:
    """Return the scene for a study: with a dwell, without its own shapers, and with the drive of the study.

    Args:
        scene: the scene.
        lowest_frequency: of the lowest mode [Hz]; a scene without dwell gets `DWELL_PERIODS` periods of it.
        drive: ``perfect`` for motors that follow their references exactly, ``controller`` for the scene's controllers
            and imperfections; None for the controllers where the scene has some, otherwise perfect.

    Raises:
        InputError: the drive is ``controller`` and the scene has none.
    """
    if drive == "controller" and not scene.controller:
        raise InputError(
            f"scene {scene.name} has no [[controller]] to study shapers with: add one, or take the perfect drive"
        )
    # sections to remove, and changes of drive and dwell
    dropped = (
        ("shaper",) if drive != "perfect" and scene.controller else ("controller", "shaper", "imperfection", "filter")
    )
    changes: dict[str, object] = {section: () for section in dropped if getattr(scene, section)}
    if "controller" in dropped and scene.cosimulation.drive != "motion":
        changes["cosimulation.drive"] = "motion"
    if scene.trajectory.dwell == 0.0:
        changes["trajectory.dwell"] = DWELL_PERIODS / lowest_frequency
    return scene.replace(changes) if changes else scene


def candidates(motion: MotionPlan, shapers: Sequence[Alternative]) -> tuple[list[ShapedMotion], Mapping[str, str]]:
    """Return the unshaped motion and every shaper on joints and path, and the reasons why some can't be applied."""
    # every shaper in every application
    found, refused = [ShapedMotion(UNSHAPED_NAME, NOTHING, UNSHAPED, motion)], dict[str, str]()
    applications = dict(APPLICATIONS)
    if not isinstance(motion.along_path, TaskTrajectory):
        del applications["path"]
        refused["all shapers on path"] = f"{motion.source} has no profile along a path"
    for shaper in shapers:
        for application, shape in applications.items():
            try:
                section = {**shaper.section, "apply": application}
                shaped = shape(motion, shaper.sequence)
                found.append(ShapedMotion(shaper.name, application, shaper.sequence, shaped, section))
            except TrajectoryError as error:
                refused[f"{shaper.name} on {application}"] = str(error)
    return found, refused


def slower(motion: MotionPlan, extra_time: float) -> ShapedMotion:
    """Return the unshaped motion, slower by a time [s], for comparison with a shaper that adds the same time."""
    scene = motion.scene.replace({"trajectory.duration": motion.duration + extra_time})
    return ShapedMotion("slower", NOTHING, UNSHAPED, plan(scene))


def study(
    candidates: Sequence[ShapedMotion],
    payload_errors: Sequence[float],
    nominal_duration: float,
    fmu_path: Path,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Iterator[CandidateResult]:
    """Co-simulate each candidate with each payload error and yield the results.

    Args:
        candidates: shaped motions of one scene.
        payload_errors: relative errors of the payload's mass; [0] for a scene without payload.
        nominal_duration: duration of the scene's own motion [s].
        fmu_path: FMU of the scene.
        progress: called with the finished fraction.

    Raises:
        CosimError: a simulation didn't reach its end.
    """
    for index, candidate in enumerate(candidates):
        trials = []
        for error in payload_errors:
            trials.append(simulate(candidate, error, fmu_path))
            progress((index + len(trials) / len(payload_errors)) / len(candidates))
        added = candidate.motion.duration - nominal_duration
        yield CandidateResult(candidate, added, candidate.motion.deviation, tuple(trials), peak_jerk(candidate.motion))


def simulate(candidate: ShapedMotion, payload_error: float, fmu_path: Path) -> PayloadTrial:
    """Co-simulate a candidate with a payload error and return its results.

    Raises:
        CosimError: the simulation didn't reach its end.
    """
    # run with the payload as a parameter of the FMU; controllers assume the scene's
    motion = candidate.motion
    scene = motion.scene
    mass = with_payload_error(scene, payload_error).payload.mass
    parameters = {"payload.mass": mass} if payload_error else {}
    run = run_scene(scene, loop=loop_of(scene, motion), fmu_path=fmu_path, parameters=parameters)
    if not run.completed:
        raise CosimError(f"{candidate.label}, payload error {payload_error:+.0%}: {run.message}")
    # a controlled robot may come to rest beside the equilibrium
    settings, offset = settings_for(run), 0.0
    if scene.controller:
        rest = np.array([run.recording[f"end_effector.position.{axis}"].values[-1] for axis in "xy"])
        offset = float(np.linalg.norm(rest - settings.end_equilibrium))
        settings = replace(settings, rest=lambda: rest)
    values = {name: measurement.value for name, measurement in measure(run.recording, settings, MEASURED).items()}
    return PayloadTrial(
        payload_error,
        values["residual_vibration_amplitude"] or 0.0,
        values["settling_time"],
        max(values["peak_torque_1"] or 0.0, values["peak_torque_2"] or 0.0),
        offset,
    )


def peak_jerk(motion: MotionPlan) -> float:
    """Return the largest third derivative of a joint reference [rad/s3]; infinite where an acceleration jumps."""
    joints = motion.joints
    times = np.union1d(np.linspace(0.0, joints.duration, JERK_POINTS), joints.breakpoints)
    left, right = (joints.evaluate(times, 3, side=side) for side in ("left", "right"))
    jump = np.abs(left[2] - right[2]).max()
    if jump > SMOOTH * np.abs(right[2]).max():
        return np.inf
    return float(max(np.abs(left[3]).max(), np.abs(right[3]).max()))


def payload_errors(scene: Scene, band: float, count: int) -> list[float]:
    """Return ``count`` (odd) relative payload errors from -band to band, with 0; [0] for a scene without payload."""
    if not scene.payload.mass or not band:
        return [0.0]
    return [float(error) for error in np.round(np.linspace(-band, band, count), 12)]
