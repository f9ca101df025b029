"""Plans a motion: search, references for the flexible robot and optimal control, judged by the FMU, the best one chosen.

Whether what it promises holds beyond the model that it was planned with: the planned joint references drive richer models of the robot,
robots at the corners of the bands, the finite elements, and robots whose motors follow by loops with encoders: the scene's own with other
payloads, or two usual ones. Limits relative to the given motion are those of the given motion in the same model.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import nan
from time import monotonic
from typing import Any

import numpy as np

from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge, noted
from flexfmu.cosim.design.plans.goals import Goals, Variation, check_holding_torque, checked_goals, judged_scene
from flexfmu.cosim.design.plans.optimal import flexible, optimal
from flexfmu.cosim.design.plans.plan_result import PlanResult, RobustnessLine
from flexfmu.cosim.design.plans.sampled_loop import joint_motion, left_in_loop, with_learned_torques
from flexfmu.cosim.design.plans.search import search
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.timing import processor_time
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal, about_scene
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.segments import Analysis, HermiteSegments
from flexfmu.cosim.metrics.signals import deviation_from_point
from flexfmu.model.finite_elements.motion import equilibrium, simulate
from flexfmu.model.finite_elements.robot import finite_element_robot
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.effects import NoDampingSection
from flexfmu.model.scene.plan import PlanSection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import damped_modes, static_equilibrium

Method = Callable[[Judge, Sequence[Assessment], int, ShowProgress], Iterator[Candidate | str]]

METHODS: Mapping[str, Method] = {"search": search, "flexible": flexible, "optimal": optimal}
"""Methods in the order in which they run, what one finds, the next can start from: from the judge, what it has assessed before, the
number of processes and where to show progress to all candidates that are tried, and why there is none from a start."""

NO_SAG = 1e-12
"""Sag [m] below which an undeformed start is at rest."""


RICHER: Mapping[str, Mapping[str, Any]] = {
    "distal bending": {"effects.distal_bending": 3},
    "shear": {"effects.beam": "timoshenko"},
    "foreshortening": {"effects.foreshortening": True},
}
"""Effects beyond the usual ones → keys of the scene."""

RICHEST = "richest model"
"""Name of the model with all of these effects, and three shapes of every family."""

BANDS = {
    "": (1.0, 1.0),
    ", stiffness -10 %": (0.9, 1.0),
    ", stiffness +10 %": (1.1, 1.0),
    ", half the damping": (1.0, 0.5),
    ", twice the damping": (1.0, 2.0),
}
"""Robots within and beyond the payload band → factors of stiffness and damping, in the richest model."""

PAYLOADS, ACCURACY = 7, (8e-4, 3e-7)
"""Payloads within the band for each model, and communication step [s] and tolerance of its runs; half of both change figures by less than 0.001 %."""

ELEMENTS, ELEMENT_STEP, ELEMENT_DWELL = 4, 8e-4, 0.06
"""Elements of a link, step [s], and standstill after the motion [s] of the finite elements; half the step changes figures by less than 0.01 %."""

SAMPLE_TIME, COUNTS, MOTOR_INERTIA = 1e-3, 1e6, 0.1
"""Of the loops: sample time [s], encoder counts a turn, and inertia of motors without one [kg.m2]."""

ENCODERS = f"encoders of {COUNTS:.0e} counts, "
"""What to know of them."""

USUAL_LOOP: dict[str, Any] = {
    "cosimulation.drive": "torque", "imperfection": [{"kind": "encoder", "counts_per_turn": COUNTS}], "filter": []
}  # fmt: skip
"""Keys of motors that follow by a loop with encoders."""

LOOPS: Mapping[str, Sequence[Mapping[str, Any]]] = {
    "computed torque at 1 kHz": (
        {"kind": "computed-torque", "proportional": 6400.0, "derivative": 160.0, "sample_time": SAMPLE_TIME},
    ),
    "PD and elastic feedforward at 1 kHz": (
        # its derivative is that of the error, so that references are as late as encoders
        {"kind": "pid", "proportional": 1e4, "integral": 0.0, "derivative": 100.0, "sample_time": SAMPLE_TIME},
        {"kind": "feedforward", "robot": "flexible", "sample_time": SAMPLE_TIME},
    ),
}
"""Controllers of each loop; the computed torque has a bandwidth of 80 rad/s."""


@one_blas_thread()
def plan_scene(
    scene: Scene,
    *,
    methods: Collection[str] | None = None,
    candidates: Sequence[Candidate] = (),
    before: Sequence[Scene] = (),
    processes: int = 1,
    budget: float | None = None,
    robust: bool = True,
    show: ShowProgress = quiet,
    journal: WorkJournal = NOWHERE,
) -> PlanResult:
    """Plan a motion for the wishes of a scene's section `plan`.

    Args:
        scene: the scene.
        methods: which of `METHODS`; None for optimal control, and for all of them beside a front or where it finds no motion within all limits.
        candidates: further motions that are assessed beside those found.
        before: the planned scenes of an earlier plan, one for each way: optimal control goes on from them, alone without ``methods``.
        processes: number of processes of the search.
        budget: time [s] after which it ends as after Ctrl-C; None for no limit.
        robust: whether the chosen motion is judged in richer models too.
        show: is called with what is being done.
        journal: where all that is found is kept, also from an earlier call for the same scene.

    Returns:
        The result; after Ctrl-C that of what was assessed so far.

    Raises:
        InputError: wishes contradict each other, or a method is unknown.
        TrajectoryError, SceneError, BuildError, ResultsError: the given motion can't be planned or run.
    """
    if unknown := [name for name in methods or () if name not in METHODS]:
        raise InputError(f"unknown method {', '.join(unknown)}; choose from {', '.join(METHODS)}")
    work, clock = processor_time(), monotonic()
    goals = checked_goals(scene)
    attempts = [["optimal"], [*METHODS]] if methods is None else [[*methods]]
    if methods is None and (before or goals.cycle or goals.wishes.front):
        # other methods know neither earlier plans nor cycles, and stand beside a front
        attempts = attempts[:1] if before or goals.cycle else attempts[1:]
    count, is_optimal, named = len(goals.ways), "optimal" in attempts[0], ", ".join(attempts[0])
    wrong = ""
    if before and len(before) != count:
        there, here = (f"{n} way{'s' * (n != 1)}" for n in (len(before), count))
        wrong = f"the earlier plan goes {there}, this one {here}: warm starts are from as many"
    elif before and not is_optimal:
        wrong = "optimal control goes on from an earlier plan: choose the method optimal too, or start anew"
    elif goals.cycle and candidates:
        wrong = "motions of your own are compared with single motions: leave out `plan.cycle`, or the motions"
    elif goals.cycle and attempts[0] and not is_optimal:
        wrong = f"a cycle is planned by optimal control alone, not by {named}: choose it, or leave out `plan.cycle`"
    elif goals.wishes.front and not is_optimal:
        wrong = "`plan.front` is found by optimal control: choose the method optimal too, or leave out the front"
    if wrong:
        raise InputError(wrong)
    goals = replace(goals, before=tuple(plan(each).once.joints for each in before))
    if goals.cycle:
        # other methods and models are for single motions
        attempts, robust = [[name for name in attempts[0] if name == "optimal"]], False
    show("the given motion", None)
    PreparedScene(scene).check_size(companion=False)
    judge, is_new = Judge(goals, journal=journal), not journal.done
    try:
        check_holding_torque(goals, judge.robots, judge.given.values["torque"])
    except InputError:
        # another plan may begin in its folder
        if is_new:
            journal.remove()
        raise
    found, failures = [judge.given], list[str]()
    # what is planned otherwise than the scene says
    away = float(np.hypot(*(static_equilibrium(goals.scene, goals.ends[0]).position - goals.trace[0])))
    if scene.cosimulation.initial == "undeformed" and away > NO_SAG:
        failures.append(
            f'`cosimulation.initial = "undeformed"` starts {1e6 * away:.3g} µm off the equilibrium, and the robot swings from there '
            f'whatever the motion: planned from rest, `initial = "static"`, which the planned scene has'
        )
    if not min(goals.band) <= goals.payload <= max(goals.band):
        failures.append(
            f"`plan.payload_band` = {[*goals.band]} is without `payload.mass` = {goals.payload:g} kg, which the planned scene has: "
            f"limits may not hold there; set `payload.mass` to one of the band, or widen the band"
        )
    candidates = [replace(each, scene=judged_scene(each.scene, goals.wishes)) for each in candidates]

    def proposed() -> Iterator[Candidate | str]:
        yield from candidates
        for attempt in attempts:
            for name in (each for each in METHODS if each in attempt):
                with noted(failures, name):
                    yield from METHODS[name](judge, found, processes, watched)
            if any(each.feasible and each.candidate.method == "optimal control" for each in found):
                return

    def watched(text: str, share: float | None) -> None:
        show(text, share)
        if budget is not None and monotonic() - clock > budget:
            raise KeyboardInterrupt

    def assess(candidate: Candidate) -> None:
        with noted(failures, candidate.label):
            found.append(judge.assess(candidate))

    lines, interrupted = list[RobustnessLine](), False
    try:
        for candidate in proposed():
            if isinstance(candidate, str):
                failures.append(candidate)
                continue
            assess(candidate)
            chosen = best(found, goals.wishes.minimise)
            watched(f"{chosen.time:.4g} s, {1e6 * chosen.residual:.2g} µm: {chosen.candidate.label}", None)
        judged = best(found, goals.wishes.minimise).candidate
        for line in robustness(judged, goals, journal=journal) if robust else ():
            show(f"the chosen motion in other models: {line.model}", None)
            lines.append(line)
    except KeyboardInterrupt as interruption:
        interrupted = True
        # what was being improved
        for each in interruption.args:
            assess(each)
    chosen, work = best(found, goals.wishes.minimise), processor_time() - work
    return PlanResult(
        goals, judge.given, chosen, tuple(found[1:]), tuple(dict.fromkeys(failures)), interrupted, work, tuple(lines)
    )


def about_plan(scene: Scene, before: Sequence[Scene]) -> dict[str, Any]:
    """What determines the results of a plan, for its journal: the scene, and the earlier plan that it goes on from."""
    # wishes that are the defaults are none
    scene = scene.model_copy(update={"plan": scene.plan or PlanSection()})
    return about_scene(scene) | ({"before": [about_scene(each) for each in before]} if before else {})


def best(found: Sequence[Assessment], minimise: str) -> Assessment:
    """Of motions that keep to all limits the one with least of what is minimised, preferring those planned for all robots; without one the
    motion whose worst excess is least."""
    return min(found, key=lambda each: (each.excess, each.candidate.is_rough, each.worst(minimise)))


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

    def line(name: str, judged: Callable[..., RobustnessLine], *arguments: Any) -> RobustnessLine:
        # or that there is none and why
        failures = list[str]()
        with noted(failures):
            made = partial(judged, name, fixed, *arguments)
            return journal.kept(("robustness", name, fixed.content), RobustnessLine, made)
        return RobustnessLine(name, nan, "", note=failures[0])

    yield line("planned model", lambda name, _: _line(name, Judge(goals, journal=journal).assess(candidate)))
    models = [(name, changes, 1.0, 1.0) for name, changes in RICHER.items()]
    models += [(f"{RICHEST}{name}", richest, *factors) for name, factors in BANDS.items()]
    for name, changes, stiffness, damping in models:
        if damping == 1.0 or not isinstance(effects.damping, NoDampingSection):
            yield line(name, _assessed, goals, changes, stiffness, damping)
    yield line("finite elements", _by_elements, goals.scene)
    if goals.loop is None:
        loop = USUAL_LOOP | {"effects.motor_inertia": effects.motor_inertia or MOTOR_INERTIA}
        for name, controllers in LOOPS.items():
            changes = {**loop, "controller": controllers}
            yield line(name, _in_a_loop, goals.scene, changes, goals.scene.payload.mass, ENCODERS)
        return
    own = with_learned_torques(goals.loop, candidate.joints, goals.scene.trajectory.dwell)
    imperfections, known = own.model_dump(exclude_none=True)["imperfection"], own.payload.mass
    for mass in dict.fromkeys(goals.band):
        # a payload that its feedforward doesn't know
        error = [{"kind": "payload-error", "relative": mass / known - 1.0}] if known else []
        yield line(f"the scene's loop, {mass:g} kg", _in_a_loop, own, {"imperfection": [*imperfections, *error]}, mass)


def _assessed(
    name: str, fixed: Candidate, goals: Goals, changes: Mapping[str, Any], stiffness: float, damping: float
) -> RobustnessLine:
    """The line of another model of the robot."""
    scene = Variation(goals.scene.payload.mass, stiffness, damping).of(goals.scene.replace({**changes}))
    of_model = replace(goals, scene=scene, loop=None, regions=goals.clearance)
    judge = Judge(of_model, PAYLOADS, NOWHERE, *ACCURACY)
    robot = {key: getattr(judge.goals.scene, key) for key in ("mechanism", "effects", "payload")}
    return _line(name, judge.assess(replace(fixed, scene=fixed.scene.model_copy(update=robot))))


def _line(name: str, found: Assessment) -> RobustnessLine:
    """What a motion needs in a model, worst over its robots."""
    worst = str(found.robots[int(found.values["residual"].argmax())])
    missed = tuple(use.name for use in found.missed)
    return RobustnessLine(name, found.residual, worst, found.torque_ratio, found.off_path, missed=missed)


def _by_elements(name: str, fixed: Candidate, scene: Scene) -> RobustnessLine:
    """The finite elements with the planned payload: as damped, at their lowest frequency, as the planned model."""
    motion = fixed.joints
    end = motion.evaluate([motion.duration], 0, "left")[0, 0]
    modes = damped_modes(scene, end)
    time = 2.0 * float(modes.ratios[0]) / (2.0 * np.pi * float(modes.frequencies[0])) if len(modes.ratios) else 0.0
    damping = {"kind": "stiffness", "time": time} if time > 0.0 else {"kind": "none"}
    robot = finite_element_robot(scene.replace({"effects.damping": damping}), ELEMENTS)
    stop = motion.duration + ELEMENT_DWELL
    found = simulate(robot, motion, np.array([motion.duration, stop]), ELEMENT_STEP, stages=True)
    ends = np.array([found.position, found.velocity])
    after = HermiteSegments(found.time[:-1], found.time[1:], ends[:, :-1], ends[:, 1:]).within(motion.duration, stop)
    residual, _ = Analysis(deviation_from_point(after, equilibrium(robot, end).position)).peak()
    note = f"{ELEMENTS} elements a link, peak torque {np.abs(found.torque).max():.4g} N·m"
    return RobustnessLine(name, residual, f"{scene.payload.mass:g} kg", note=note)


def _in_a_loop(
    name: str, fixed: Candidate, scene: Scene, changes: Mapping[str, Any], mass: float, note: str = ""
) -> RobustnessLine:
    """The line of a loop, a scene with changes, that carries a mass [kg]."""
    residual, error = left_in_loop(scene.replace({**changes}), fixed.joints, fixed.scene.trajectory.dwell)
    return RobustnessLine(name, residual, f"{mass:g} kg", note=f"{note}{error}")
