"""Whether what a plan promises holds beyond the model that it was planned with.

The planned joint references drive richer models of the robot, robots at the corners of the bands, the finite elements, and robots
whose motors follow by loops with encoders: the scene's own with other payloads, or two usual ones. Limits relative to the given motion are those of the given motion
in the same model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import nan
from typing import Any

import numpy as np

from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.design.plans.assessment import STEP, Candidate, Judge, noted
from flexfmu.cosim.design.plans.goals import Goals, Variation, goals_of
from flexfmu.cosim.design.plans.sampled_loop import joint_motion, loop_run, tracking_error, with_learned_torques
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.model.finite_elements.motion import equilibrium, simulate
from flexfmu.model.finite_elements.robot import finite_element_robot
from flexfmu.model.scene.effects import NoDampingSection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import damped_modes

RICHER: Mapping[str, Mapping[str, Any]] = {
    "distal bending": {"effects.distal_bending": 3},
    "shear": {"effects.beam": "timoshenko"},
    "foreshortening": {"effects.foreshortening": True},
}
"""Effects beyond the usual ones → keys of the scene."""

RICHEST = "richest model"
"""Name of the model with all of these effects, and three shapes of every family."""

BANDS = {
    "stiffness -10 %": (0.9, 1.0),
    "stiffness +10 %": (1.1, 1.0),
    "half the damping": (1.0, 0.5),
    "twice the damping": (1.0, 2.0),
}
"""Robots beyond the payload band → factors of stiffness and damping, in the richest model."""

PAYLOADS = 7
"""Payloads within the band for each model."""

ELEMENTS, ELEMENT_STEP, ELEMENT_DWELL = 4, 2.5e-4, 0.06
"""Elements of a link, step [s], and standstill after the motion [s] of the finite elements."""

SAMPLE_TIME, COUNTS, MOTOR_INERTIA = 1e-3, 1e6, 0.1
"""Of the loops: sample time [s], encoder counts a turn, and inertia of motors without one [kg.m2]."""

LOOPS: Mapping[str, Sequence[Mapping[str, Any]]] = {
    "computed torque at 1 kHz": ({"kind": "computed-torque", "proportional": 6400.0, "derivative": 160.0},),
    "PD and elastic feedforward at 1 kHz": (
        # its derivative is that of the error, so that references are as late as encoders
        {"kind": "pid", "proportional": 1e4, "integral": 0.0, "derivative": 100.0},
        {"kind": "feedforward", "robot": "flexible"},
    ),
}
"""Controllers of each loop; the computed torque has a bandwidth of 80 rad/s."""


@dataclass(frozen=True)
class RobustnessLine:
    """What remains of a plan's promise in another model.

    Attributes:
        model: the model.
        residual: worst residual vibration [m], and for which robot.
        where: that robot.
        torque_ratio: worst ratio of peak torques to the given motion's in the same model; NaN if it isn't compared.
        off_path: largest distance of the end effector from the given path [m]; NaN if it isn't known.
        uses: use of each limit; empty if the limits aren't judged here.
        note: what else to know, in a few words.
    """

    model: str
    residual: float
    where: str
    torque_ratio: float = nan
    off_path: float = nan
    uses: tuple[Limit, ...] = ()
    note: str = ""

    @property
    def missed(self) -> tuple[str, ...]:
        """Names of the limits that don't hold."""
        return tuple(use.name for use in self.uses if not use.met)


def robustness(candidate: Candidate, goals: Goals, *, journal: WorkJournal = NOWHERE) -> Iterator[RobustnessLine]:
    """What remains of the candidate's figures in richer models, beyond the bands, and in a loop.

    Args:
        candidate: the motion.
        goals: what it was planned for.
        journal: where lines are kept.

    Raises:
        TrajectoryError: the motion isn't feasible.
        BuildError: a model's FMU can't be built.
    """
    # as a motion of the joints: other models don't change shapers that belong to it
    scene, effects = candidate.scene.replace({"shaper": []}), goals.scene.effects
    fixed = Candidate(candidate.label, candidate.method, scene, joint_motion(candidate.joints))
    families = ("proximal_bending", "proximal_axial", "distal_bending", "distal_axial")
    richest: dict[str, Any] = {key: value for changes in RICHER.values() for key, value in changes.items()}
    richest |= {f"effects.{key}": max(3, getattr(effects, key)) for key in families}
    robots = {"planned model": ({}, 1.0, 1.0), **{name: (changes, 1.0, 1.0) for name, changes in RICHER.items()}}
    robots[RICHEST] = richest, 1.0, 1.0
    for name, (stiffness, damping) in BANDS.items():
        if damping == 1.0 or not isinstance(effects.damping, NoDampingSection):
            robots[f"{RICHEST}, {name}"] = richest, stiffness, damping
    lines: dict[str, Callable[[str], RobustnessLine]]
    lines = {name: partial(_assessed, fixed, goals, *robot) for name, robot in robots.items()}
    lines["finite elements"] = partial(_by_elements, fixed, goals)
    if goals.loop is None:
        where = f"{goals.scene.payload.mass:g} kg"
        for name, controllers in LOOPS.items():
            lines[name] = partial(_in_a_loop, goals.scene, _usual_loop(goals.scene, controllers), fixed, where)
    else:
        loop = with_learned_torques(goals.loop, candidate.joints, goals.scene.trajectory.dwell)
        for mass in dict.fromkeys(goals.band):
            changes = _other_payload(loop, mass)
            lines[f"the scene's loop, {mass:g} kg"] = partial(_in_a_loop, loop, changes, fixed, f"{mass:g} kg")
    # each of them, or that there is none and why
    content = fixed.content
    for name, line in lines.items():
        found, failures = list[RobustnessLine](), list[str]()
        with noted(failures):
            found.append(journal.kept(("robustness", name, content), RobustnessLine, partial(line, name)))
        yield from found or [RobustnessLine(name, nan, "", note=failures[0])]


def _assessed(
    fixed: Candidate, goals: Goals, changes: Mapping[str, Any], stiffness: float, damping: float, name: str
) -> RobustnessLine:
    """The line of another model of the robot."""
    scene = goals.scene.replace({**changes}) if changes else goals.scene
    judge = Judge(goals_of(Variation(scene.payload.mass, stiffness, damping).of(scene)), PAYLOADS)
    robot = {key: getattr(judge.goals.scene, key) for key in ("mechanism", "effects", "payload")}
    found = judge.assess(replace(fixed, scene=fixed.scene.model_copy(update=robot)))
    worst = max(found.peaks, key=lambda each: each.values["residual"])
    return RobustnessLine(name, found.residual, str(worst.variation), found.torque_ratio, found.off_path, found.uses)


def _by_elements(fixed: Candidate, goals: Goals, name: str) -> RobustnessLine:
    """The finite elements with the planned payload: as damped, at their lowest frequency, as the planned model."""
    assert fixed.trajectory is not None
    scene, motion = goals.scene, fixed.trajectory
    end = motion.evaluate([motion.duration], 0, "left")[0, 0]
    modes = damped_modes(scene, end)
    time = 2.0 * float(modes.ratios[0]) / (2.0 * np.pi * float(modes.frequencies[0])) if len(modes.ratios) else 0.0
    damping = {"kind": "stiffness", "time": time} if time > 0.0 else {"kind": "none"}
    robot = finite_element_robot(scene.replace({"effects.damping": damping}), ELEMENTS)
    count = round((motion.duration + ELEMENT_DWELL) / STEP)
    instants = np.append(STEP * np.arange(1.0, count), motion.duration + ELEMENT_DWELL)
    found = simulate(robot, motion, np.unique(np.append(instants, motion.duration)), ELEMENT_STEP)
    after = found.time >= motion.duration - 1e-9
    rest = equilibrium(robot, end).position
    residual = float(np.hypot(*(found.position[after] - rest).T).max())
    note = f"{ELEMENTS} elements a link, peak torque {np.abs(found.torque).max():.4g} N·m"
    return RobustnessLine(name, residual, f"{scene.payload.mass:g} kg", note=note)


def _other_payload(loop: Scene, mass: float) -> Mapping[str, Any]:
    """Keys of the scene's own loop with a payload that its feedforward doesn't know."""
    if not loop.payload.mass:
        return {}
    payload = {"kind": "payload-error", "relative": mass / loop.payload.mass - 1.0}
    return {"imperfection": [*loop.model_dump(exclude_none=True)["imperfection"], payload]}


def _usual_loop(scene: Scene, controllers: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """Keys of motors that follow by a loop with encoders."""
    return {
        "cosimulation.drive": "torque",
        "effects.motor_inertia": scene.effects.motor_inertia or MOTOR_INERTIA,
        "controller": [{"sample_time": SAMPLE_TIME, **each} for each in controllers],
        "imperfection": [{"kind": "encoder", "counts_per_turn": COUNTS}],
        "filter": [],
    }


def _in_a_loop(scene: Scene, changes: Mapping[str, Any], fixed: Candidate, where: str, name: str) -> RobustnessLine:
    """The line of a loop: a scene with changes."""
    run = loop_run(scene.replace({**changes}), fixed.joints, fixed.scene.trajectory.dwell)
    note = f"tracking error {1e3 * tracking_error(run):.3g} mrad"
    note = f"encoders of {COUNTS:.0e} counts, {note}" if name in LOOPS else note
    return RobustnessLine(name, float(run.metrics["residual_vibration_amplitude"]), where, note=note)
