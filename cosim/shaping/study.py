"""What shapers do to a scene: co-simulations of the motion-driven FMU, one FMU with the payload as its parameter."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from flexfmu.cosim.errors import CosimError
from flexfmu.cosim.experiment import run_scene
from flexfmu.cosim.imperfections.payload_error import with_payload_error
from flexfmu.cosim.metrics import measure_run
from flexfmu.cosim.planning import MotionPlan, plan
from flexfmu.cosim.shaping.design import Alternative
from flexfmu.cosim.shaping.plan import APPLICATIONS, deviation
from flexfmu.model.scene import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.shapers.sequence import UNSHAPED, ImpulseSequence

UNSHAPED_NAME, NOTHING = "unshaped", "-"
"""Name of the motion as it is, and what is shaped then."""

DWELL_PERIODS = 15.0
"""Dwell in periods of the lowest mode, for a scene without one: without a dwell there is no residual vibration."""


@dataclass(frozen=True)
class Trial:
    """One co-simulation.

    Attributes:
        payload_error: relative error of the payload's mass.
        residual: largest distance of the end effector from its equilibrium during the dwell [m].
        settling_time: time after the motion's end from which it stays in the settling band [s]; None if it doesn't
            within the dwell.
        peak_torque: largest torque of either motor over the motion [N.m].
    """

    payload_error: float
    residual: float
    settling_time: float | None
    peak_torque: float


@dataclass(frozen=True)
class Candidate:
    """A shaper applied in one of the two ways, or the unshaped motion.

    Attributes:
        name: of the shaper.
        application: ``joints`` or ``path``; ``-`` for none.
        sequence: its impulses.
        motion: the shaped motion.
    """

    name: str
    application: str
    sequence: ImpulseSequence
    motion: MotionPlan

    @property
    def label(self) -> str:
        """Name and application in words."""
        return self.name if self.application == NOTHING else f"{self.name} on {self.application}"


@dataclass(frozen=True)
class Result:
    """What a candidate does, over all payload errors.

    Attributes:
        candidate: what was simulated.
        added_time: by how much the motion is longer than the scene's own [s].
        path_deviation: largest distance of the rigid end effector from the scene's path [m].
        trials: one for each payload error.
    """

    candidate: Candidate
    added_time: float
    path_deviation: float
    trials: tuple[Trial, ...]

    @cached_property
    def nominal(self) -> Trial:
        """The trial with the scene's own payload."""
        return min(self.trials, key=lambda trial: abs(trial.payload_error))

    @property
    def worst_residual(self) -> float:
        """Largest residual vibration over the payload band [m]."""
        return max(trial.residual for trial in self.trials)

    @property
    def worst_settling_time(self) -> float | None:
        """Longest settling time over the payload band [s]; None where one didn't settle."""
        times = [trial.settling_time for trial in self.trials]
        return None if None in times else max(time for time in times if time is not None)

    @property
    def time_to_rest(self) -> float | None:
        """Added time and longest settling time [s]: how long after the unshaped motion's end there is rest."""
        settling = self.worst_settling_time
        return None if settling is None else self.added_time + settling


LOOP_SECTIONS = ("controller", "shaper", "imperfection")
"""Sections of a scene that stand between motion and robot; the study puts its own shapers there and nothing else."""


def motion_driven(scene: Scene, lowest_frequency: float) -> Scene:
    """The scene as the study needs it: driven by motion, nothing between motion and robot, with a dwell."""
    changes: dict[str, object] = {section: () for section in LOOP_SECTIONS if getattr(scene, section)}
    if scene.cosimulation.drive != "motion":
        changes["cosimulation.drive"] = "motion"
    if scene.trajectory.dwell == 0.0:
        changes["trajectory.dwell"] = DWELL_PERIODS / lowest_frequency
    return scene.replace(changes) if changes else scene


def candidates(motion: MotionPlan, shapers: Sequence[Alternative]) -> tuple[list[Candidate], Mapping[str, str]]:
    """The unshaped motion and every shaper in both ways; what can't be applied is left out, with the reason."""
    found, refused = [Candidate(UNSHAPED_NAME, NOTHING, UNSHAPED, motion)], {}
    for shaper in shapers:
        for application, shape in APPLICATIONS.items():
            try:
                found.append(Candidate(shaper.name, application, shaper.sequence, shape(motion, shaper.sequence)))
            except TrajectoryError as error:
                refused[f"{shaper.name} on {application}"] = str(error)
    return found, refused


def slower(motion: MotionPlan, extra_time: float) -> Candidate:
    """The unshaped motion, slower by a time [s]: what the time that a shaper adds could have bought instead."""
    scene = motion.scene.replace({"trajectory.duration": motion.duration + extra_time})
    return Candidate("slower", NOTHING, UNSHAPED, plan(scene))


def study(
    candidates: Sequence[Candidate],
    payload_errors: Sequence[float],
    nominal_duration: float,
    fmu_path: Path,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Iterator[Result]:
    """Co-simulate each candidate with each payload error.

    Args:
        candidates: shaped motions of one scene.
        payload_errors: relative errors of the payload's mass; just 0 for a scene without payload.
        nominal_duration: duration of the scene's own motion [s].
        fmu_path: the scene's motion-driven FMU.
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
        yield Result(candidate, added, deviation(candidate.motion), tuple(trials))


def simulate(candidate: Candidate, payload_error: float, fmu_path: Path) -> Trial:
    """One co-simulation, measured.

    Raises:
        CosimError: it didn't reach its end.
    """
    scene = with_payload_error(candidate.motion.scene, payload_error)
    run = run_scene(scene, motion=replace(candidate.motion, scene=scene), fmu_path=fmu_path)
    if not run.completed:
        raise CosimError(f"{candidate.label}, payload error {payload_error:+.0%}: {run.message}")
    values = {name: measurement.value for name, measurement in measure_run(run).items()}
    return Trial(
        payload_error,
        values["residual_vibration_amplitude"] or 0.0,
        values["settling_time"],
        max(values["peak_torque_1"] or 0.0, values["peak_torque_2"] or 0.0),
    )


def payload_errors(scene: Scene, band: float, count: int) -> list[float]:
    """So many relative payload errors between -band and band, 0 among them; 0 alone for a scene without payload."""
    if not scene.payload.mass or not band:
        return [0.0]
    return [float(error) for error in np.round(np.linspace(-band, band, count), 12)]
