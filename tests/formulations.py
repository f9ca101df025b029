"""Comparison of the assumed-shape model with independent formulations: finite elements and Exudyn.

All compare the same robot: every link bends and stretches, and damping is proportional to stiffness, since modal damping
belongs to modes and has no counterpart in other formulations.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from flexfmu.benchmarks.peers.exudyn_trials import DAMPING_TIME
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.studies.workprec.trial import completed
from flexfmu.model.finite_elements.motion import element_frequencies, equilibrium
from flexfmu.model.finite_elements.robot import FiniteElementRobot
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import natural_frequencies, static_equilibrium

Beam = Literal["euler-bernoulli", "timoshenko"]

SHAPES = {
    "effects.basis": "craig-bampton",
    "effects.proximal_bending": 3,
    "effects.proximal_axial": 2,
    "effects.distal_bending": 2,
    "effects.distal_axial": 2,
}
"""Numbers of shapes that give four digits of the first natural frequencies."""

SAMPLING = 1e-3
"""Spacing of the instants at which motions are compared [s]."""

TOLERANCE = 1e-8
"""Relative tolerance of the FMU's integrator, far below the differences between formulations."""

FREQUENCIES = 4
"""Number of natural frequencies compared at each pose."""

POSES = 5
"""Number of poses, equally spaced in time over the motion."""


@dataclass(frozen=True)
class ComputedMotion:
    """A computed motion at N instants: position and acceleration of the end effector [m, m/s²], torques of the motors [N m], (N, 2) each;
    results of other formulations have these fields too."""

    position: RealArray
    acceleration: RealArray
    torque: RealArray


@dataclass(frozen=True)
class RestAgreement:
    """Relative differences of two formulations at rest.

    Attributes:
        frequency: largest difference of the first natural frequencies at poses along the motion.
        sag: difference of the static deflections at the start, norm of the vector.
        torque: difference of the static torques at the start, norm of the vector.
    """

    frequency: float
    sag: float
    torque: float


@dataclass(frozen=True)
class MotionAgreement:
    """Relative differences of two formulations over a motion.

    Attributes:
        position: largest distance between the two end effectors, relative to the largest distance from the rigid robot's.
        peak_position_error, rms_acceleration_error, peak_torque: differences of these metrics at the compared instants.
        torque: largest difference at any instant, relative to the peak torque.
    """

    position: float
    peak_position_error: float
    rms_acceleration_error: float
    torque: float
    peak_torque: float


def full_scene(scene: Scene, beam: Beam, foreshortening: bool | Literal["exact"]) -> Scene:
    """A scene's robot with enough shapes of every family, and damping that other formulations have too."""
    damping = {"kind": "stiffness", "time": DAMPING_TIME}
    changes = {"effects.damping": damping, "effects.beam": beam, "effects.foreshortening": foreshortening}
    return scene.replace(SHAPES | changes)


def sample_instants(motion: MotionPlan) -> RealArray:
    """Whole multiples of `SAMPLING` over motion and dwell [s]."""
    return SAMPLING * np.arange(1.0, round(motion.stop_time / SAMPLING) + 1.0)


def shapes_motion(scene: Scene, instants: RealArray, fmu_path: Path | None = None) -> ComputedMotion:
    """The motion of the scene's own model, by its FMU, at instants (N,) that are multiples of `SAMPLING`.

    Args:
        scene: the robot and its motion.
        instants: (N,) [s].
        fmu_path: an FMU of a scene with the same effects, instead of building one.

    Raises:
        RunError: the run ended before its time.
    """
    run = run_scene(scene, communication_step=SAMPLING, tolerance=TOLERANCE, fmu_path=fmu_path)
    recording = completed(run).recording
    # where an instant appears twice, the value before the jump
    rows = np.searchsorted(recording.time, instants - 0.01 * SAMPLING)
    return ComputedMotion(
        _vector(recording, "end_effector.position.x", "end_effector.position.y")[rows],
        _vector(recording, "end_effector.acceleration.x", "end_effector.acceleration.y")[rows],
        _vector(recording, "joint1.torque", "joint2.torque")[rows],
    )


def _vector(recording: Recording, *names: str) -> RealArray:
    return np.asarray(np.stack([recording[name].values for name in names], axis=1))


def compare_at_rest(scene: Scene, motion: MotionPlan, elements: FiniteElementRobot) -> RestAgreement:
    """The scene's model against finite elements, with the motors locked.

    Raises:
        EquilibriumError: there is no static equilibrium at a pose.
    """
    poses = motion.joints.evaluate(np.linspace(0.0, motion.duration, POSES), 0)[0]
    ours = np.array([natural_frequencies(scene, joints)[:FREQUENCIES] for joints in poses])
    theirs = np.array([element_frequencies(elements, joints, FREQUENCIES) for joints in poses])
    start, rigid = poses[0], motion.task.evaluate(0.0, 0)[0, 0]
    here, there = static_equilibrium(scene, start), equilibrium(elements, start)
    return RestAgreement(
        frequency=float(np.abs(ours / theirs - 1.0).max()),
        sag=_relative(here.position - there.position, there.position - rigid),
        torque=_relative(here.torque - there.torque, there.torque),
    )


def compare_motions(
    ours: ComputedMotion, theirs: ComputedMotion, motion: MotionPlan, instants: RealArray
) -> MotionAgreement:
    """Compare two motions at the same instants (N,) [s]; differences are relative to ``theirs``."""
    # metrics of both motions against the rigid robot
    rigid = motion.task.evaluate(instants, 2, side="left")
    moving = instants <= motion.duration
    peaks = [np.linalg.norm(each.position - rigid[0], axis=1).max() for each in (ours, theirs)]
    rms = [np.linalg.norm((each.acceleration - rigid[2])[moving]) for each in (ours, theirs)]
    torques = [np.abs(each.torque[moving]).max(axis=0) for each in (ours, theirs)]
    return MotionAgreement(
        position=float(np.linalg.norm(ours.position - theirs.position, axis=1).max() / peaks[1]),
        peak_position_error=float(abs(peaks[0] / peaks[1] - 1.0)),
        rms_acceleration_error=float(abs(rms[0] / rms[1] - 1.0)),
        torque=float((np.abs(ours.torque - theirs.torque).max(axis=0) / torques[1]).max()),
        peak_torque=float(np.abs(torques[0] / torques[1] - 1.0).max()),
    )


def _relative(difference: RealArray, vector: RealArray) -> float:
    return float(np.linalg.norm(difference) / np.linalg.norm(vector))
