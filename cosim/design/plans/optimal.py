"""Joint references of the flexible robot as methods of the planner: by optimal control, and on the given path in the given time.

Optimal control finds the fastest motion, or that of least effort, whose limits hold for all robots of the bands. They hold in the scene's model and in a fuller one: shear, distal bending and foreshortening lower the lowest frequencies by up to
2 %, and a motion that leaves no vibration in one model alone leaves up to 10 µm in the other.

On the given path the end effector of the flexible robot makes the given motion. The same programmes correct these references until limits hold
over the bands, near the path.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from typing import Any, Generic, TypeVar

import numpy as np

from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge
from flexfmu.cosim.design.plans.clearance import RETURN
from flexfmu.cosim.design.plans.goals import ONCE, RATES, Goals, Variation
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.showing import ShowProgress
from flexfmu.cosim.experiment.planning import plan_rigid
from flexfmu.model.reference_design import optimal_control
from flexfmu.model.reference_design.elastic_response import (
    COMPARED,
    LINK_LOADS,
    SHARED,
    ElasticResponse,
    RobotVariant,
    joined,
)
from flexfmu.model.reference_design.inverse_dynamics import LEAD, flexible_references
from flexfmu.model.reference_design.joint_spline import REST, DesignedMotion, JointSpline, fitted
from flexfmu.model.reference_design.loads import OF_CYCLE, ROOTS, Loads, weight_of_squares
from flexfmu.model.reference_design.optimal_control import MotionProblem, Way, fleet_of
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.motion import TableSection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.trajectory import Trajectory

INTERVALS, CROWDING = 48, 0.7
"""Intervals between the knots of the splines, and how much denser they are near both ends. Uniform ones give motions that are 1 to 3 % slower,
even 80."""

PAYLOADS = 25, 13
"""Payloads of the band for which the limits hold: in the scene's model, and in the fuller one."""

FULLER_NODES = 4
"""Payloads that the programmes have of the fuller model."""

FEW, WIDE = 3, 24
"""Payloads of the scene's model for a first motion, which may vibrate, and intervals of its splines: it takes a second, and 1 % longer or less
than the best motion for all."""

GIVEN_STEPS, SWINGING = 304, 2.0
"""Steps of the integration for the given motion's loads, and for how many of its durations the robot swings after it, at most."""

STARTS = (0.65, 0.5, 0.8)
"""Durations of the first motions where it is free, relative to the given one: the next serves where the one before finds nothing."""

RESERVE = 0.9995, 0.8, 1.04
"""Shares of the limits of torque, clearance and residual that motions use; the FMU judges the rest. The residual vibration is bounded by a sum over
the modes, which is 5 to 45 % too large."""

NEARLY = 0.03
"""Violation of the limits up to which a motion is worth correcting; beyond it the next start is tried."""

TRIES, SURE, SLOWER = 5, 1.02, 1.05
"""Motions that are judged from one start, at most, the factor on what one exceeds limits by, and that on its time for the next
start, if it exceeds one by more: a slower one has room to reach the limits."""

FEWER, NEAR_LIMITS = 0.9, 1.1
"""Another correction follows where the last one lowered the excess to at most this share, or where the excess is at most this large."""

ACTIVE, FULL, FULL_RESIDUAL = 0.98, 0.999, 0.85
"""Share of a limit from which on it is active, and shares of limits and of the residual vibration that motions may use."""

LOADS = optimal_control.GROUPS[optimal_control.RESIDUAL + 1 :]
"""Limits of motors, joints and links besides the torque, which the programmes have."""


CORRECTED_FOR, CORRECTED_AT, LEAST_PARTS = 16, 0.008, 24
"""Payloads of the correction on the given path, distance of the knots of its references [s], and of how many it has one at least: closer ones follow
the path's kinks with more jerk and power."""

QUIET, NEAR_PATH, GROWTH = 0.2, 0.9, 1.2
"""Shares of the allowed residual vibration and margin that it may use, and by how much the distance from the path may grow where it is more before."""

Motion = TypeVar("Motion", bound=DesignedMotion)

Robots = Sequence[RobotVariant]
"""The robot of each case of a way, those of one scene behind each other; several cases may have the same."""

Refined = Generator[Candidate | str, None, tuple[list[Motion], Assessment] | None]
"""Yields motions, or why there is none, and returns the last ones as they were judged."""

Optimum = tuple[list[list[float]], float] | None
"""What a journal has of motions: the variables of each, with their worst violation; None where there is no motion."""


def optimal(judge: Judge, found: Sequence[Assessment], processes: int, show: ShowProgress) -> Iterator[Candidate | str]:
    """The best motions within the bands, from the given one on, each corrected until the FMU finds all limits kept.

    Arguments as for `planner.Method`.

    Raises:
        InputError: the given motion ends where it starts.
    """
    goals = judge.goals
    if np.hypot(*(goals.trace[-1] - goals.trace[0])) < RETURN:
        raise InputError("optimal control plans a motion from one place to another, and this one ends where it starts")
    motions, nodes, few = _ways(goals)
    given = [each.first_motion for each in goals.ways]

    def made(splines: Sequence[JointSpline]) -> Candidate:
        time = sum(each.duration for each in splines) + goals.rest
        aim = "robust" if goals.wishes.minimise == "time" else goals.wishes.minimise
        return _candidate(goals, f"optimal control, {aim}, {time:.4g} s", splines)

    improver = Improver(judge, made, nodes, goals.wishes.minimise, show)

    # what takes longest, when a first motion is there
    whole = cache(lambda: limited(goals, found[0], motions))

    def refined(key: str | float, splines: Sequence[JointSpline], loose: float = 0.0) -> Refined[JointSpline]:
        return improver.refined(("optimal", key), whole().begun(splines, loose=loose), gives_back=key != "before")

    def from_start_to_start() -> Iterator[Candidate | str]:
        # near the best motions, if places and payloads have moved little
        if goals.before and (yield from refined("before", list(map(_moved, goals.before, map(_spline, given))))):
            return
        # first motions with the first bound of the residual vibration, and what is found on the way to them, once
        problem = limited(goals, found[0], few)
        is_first = all(each.candidate.method != "optimal control" for each in found)
        vibrating = {"residual": min(1.0, problem.residual / optimal_control.LOOSE)}
        for share in _shares(goals, found[0]) if is_first else ():
            begun = problem.tightened(vibrating).begun([_spline(each, WIDE) for each in given], share)
            tried = improver.best(("optimal", share, "few"), begun)
            if tried is None:
                yield f"optimal from {share}, few payloads: no motion can be planned"
                continue
            candidate = made(tried[0])
            yield replace(candidate, label=f"{candidate.label}, few payloads", is_rough=True)
            splines = [_spline(each.trajectory()) for each in tried[0]]
            if tried[1] and (yield from refined(share, splines, optimal_control.LOOSE)):
                return
        # the best motion of other methods, if there is one
        others = [each for each in found if each.feasible and each.candidate.method != "given"]
        if others and not goals.cycle:
            best = min(others, key=lambda each: each.worst(goals.wishes.minimise))
            yield from refined("other", [_spline(best.candidate.joints)])

    yield from from_start_to_start()
    if goals.wishes.front or goals.wishes.minimise == "residual":
        yield from _front(goals, found[0], motions, improver)


@dataclass(frozen=True, eq=False)
class Improver(Generic[Motion]):
    """Finds the best motions of a kind, and corrects their limits by what the FMU finds.

    Attributes:
        judge: finds it; knows the goals and the journal.
        made: the candidate of motions, one for each way.
        nodes: indices of the cases that the programmes have, if there are so many.
        aim: what is minimised.
        show: is called with what is being done.
        near: violation of the limits up to which a motion is worth correcting.
        tries: motions that are judged from one start, at most.
    """

    judge: Judge
    made: Callable[[Sequence[Motion]], Candidate]
    nodes: Sequence[int]
    aim: optimal_control.Aim
    show: ShowProgress
    near: float = NEARLY
    tries: int = TRIES

    def best(self, key: tuple[Any, ...], problem: MotionProblem) -> tuple[list[Motion], bool] | None:
        """The best motions, from the journal or by optimal control, and whether their violations are small; None for none.

        Args:
            key: of the journal.
            problem: limits and first motions.

        Raises:
            KeyboardInterrupt: after Ctrl-C, or of ``show``, with the candidate that there is so far, if there is one.
        """
        cases = range(len(problem.ways[0].robots))

        def found() -> Optimum:
            last: Any = ((), {})
            # few cases have no others between them
            some = self.nodes if max(self.nodes) in cases else cases
            try:
                for last in optimal_control.optimal_motion(problem, some, aim=self.aim):
                    time = self.judge.goals.rest + sum(each.duration for each in last[0])
                    self.show(f"{key[0]} over the bands: {time:.4g} s", None)
            except EquilibriumError:
                # too fast for the links: a slower start may do
                return None
            except KeyboardInterrupt:
                # the best motion so far is judged all the same
                candidates = [self.made(last[0])] if last[0] else []
                raise KeyboardInterrupt(
                    *(replace(each, label=f"{each.label}, interrupted") for each in candidates)
                ) from None
            return [each.variables.tolist() for each in last[0]], max(last[1].values())

        kept = self.judge.journal.kept(key, Optimum, found)
        if kept is None:
            return None
        pairs: Any = zip((way.start for way in problem.ways), kept[0], strict=True)
        return [start.moved(np.array(each) - start.variables) for start, each in pairs], kept[1] < self.near

    def refined(self, key: tuple[Any, ...], problem: MotionProblem, *, gives_back: bool = True) -> Refined[Motion]:
        """Motions from one start on, each with limits corrected by what the FMU finds; returns the last ones as they were judged, if there are any.

        Args:
            key, problem: as for `best`; the key begins those of the journal.
            gives_back: whether what a motion leaves of the limits is given back, once.
        """
        last, is_free = None, self.judge.goals.wishes.duration is None
        for number in range(self.tries):
            tried = self.best((*key, number), problem)
            if tried is None:
                yield f"{' from '.join(map(str, key))}, try {number + 1}: no motion can be planned"
                break
            motions, is_near = tried
            made, again = self.made(motions), f", try {number + 1}" * (number > 0)
            candidate = replace(made, label=f"{made.label}{again}")
            yield candidate
            if not is_near:
                break
            judged = self.judge.assess(candidate)
            # tighter limits hardly help: a loop leaves something by itself, for example
            is_stuck = last is not None and judged.excess > max(NEAR_LIMITS, FEWER * last[1].excess)
            last, factors = (motions, judged), corrections(judged)
            if is_stuck or not factors or (judged.feasible and not (gives_back and is_free)):
                break
            gives_back = gives_back and not judged.feasible
            # what the FMU finds beyond the limits is taken off them, from this motion on
            most = max((each for name, each in factors.items() if name != "residual"), default=1.0)
            problem = problem.tightened(factors).begun(motions, SLOWER if is_free and most > SLOWER else 1.0)
        return last


FRONT_TO: Mapping[str, tuple[float, float]] = {
    "power": (0.35, 1 / 3), "rms_torque": (0.6, 0.5), "energy": (0.5, 0.5), "jerk": (0.25, 1 / 3), "residual": (0.01, 0.1)
}  # fmt: skip
"""Levels of a front down to this share of what the motion without that limit needs, and the exponent with which the time falls as the level
rises; the residual vibration falls faster, and only slows a motion down, by and by."""

NEAR_FRONT = 0.1
"""Violation of the limits up to which a motion of a front is worth correcting."""

LEVELS, LIFTED = (10, 4), 1e3
"""Numbers of levels of fronts of two figures and of three, and the factor of a limit that isn't one."""


def _front(
    goals: Goals, given: Assessment, robots: Sequence[Robots], improver: Improver[JointSpline]
) -> Iterator[Candidate | str]:
    """What is minimised for many levels of the front's other figures, each from the motion of the level before.

    The least residual vibration is found so too, at the last level that a motion reaches.
    """
    figures = goals.wishes.front
    axes: list[str] = [each for each in figures if each != goals.wishes.minimise] or ["residual"]
    own = {name: Limit(name, 1.0, "1", is_relative=True) for name in axes if name != "residual"}
    units = limited(replace(goals, limits={**goals.limits, **own}), given, robots)
    # from what the motion needs without these limits on, or from where the wishes end
    natural = dict.fromkeys(axes, 1.0)
    for name in own:
        usual = given.values[name][given.values[name] > 0.0]
        natural[name] = float((goals.limit(name, usual) / usual).min(initial=LIFTED))
    levels = [np.geomspace(1.0, FRONT_TO[name][0], LEVELS[len(axes) - 1 if figures else 1]).tolist() for name in axes]
    # forth and back, so that neighbours follow each other
    grid = [(first, *more) for k, first in enumerate(levels[0]) for more in list(product(*levels[1:]))[:: (-1) ** k]]
    last, before = None, dict[str, float]()
    for number, shares in enumerate(grid):
        factors = {name: natural[name] * share for name, share in zip(axes, shares, strict=True)}
        excess = {name: 1.0 / factor for name, factor in factors.items()}
        label = f"{'front, level' if figures else 'least residual,'} {number + 1} of {len(grid)}"
        level = replace(improver, made=partial(_candidate, goals, label), near=NEAR_FRONT, tries=3)
        if last is None:
            motions, starts, loose = [way.start for way in units.ways], _shares(goals, given), optimal_control.LOOSE
        else:
            rises = [(before[name] / each) ** FRONT_TO[name][1] for name, each in factors.items()]
            slower = 1.0 if goals.wishes.duration is not None else max(*rises, 0.9)
            motions, starts, loose = [*last[0]], (slower,), 0.0
        for share in starts:
            problem = units.tightened(excess).begun(motions, share, loose)
            if found := (yield from level.refined(("front", number, share), problem, gives_back=False)):
                last, before = found, factors
                break
        if last is None:
            return
        if number == 0:
            # what the motion needs without these limits
            needed = {name: float((last[1].values[name] / given.values[name]).max()) for name in own}
            natural |= {name: min(natural[name], each) for name, each in needed.items()}
            before = {**before, **needed}


def _shares(goals: Goals, given: Assessment) -> tuple[float, ...]:
    """Durations of first motions, relative to those of the given ones."""
    if goals.wishes.duration is None:
        return STARTS
    return ((goals.wishes.duration - goals.rest) / (given.time - goals.rest),)


def _spline(joints: Trajectory, intervals: int = 0) -> JointSpline:
    """The spline that is closest to a motion of the joints, of `INTERVALS` or as many as are given."""
    return fitted(joints, intervals or INTERVALS, side="left", crowding=CROWDING)


def _moved(before: Trajectory, given: DesignedMotion) -> JointSpline:
    """An earlier motion from start to end of the given one, by a smooth shift; equal coefficients at the ends stay equal."""
    spline, (first, last) = _spline(before), given.evaluate([0.0, 1.0], 0)[0]
    along = np.clip((np.arange(len(spline.coefficients)) - REST) / (len(spline.coefficients) - 2 * REST - 1), 0.0, 1.0)
    step = (along**3 * (10.0 - 15.0 * along + 6.0 * along**2))[:, np.newaxis]
    # angles of another turn are the same
    shifts = np.stack([first, last]) - spline.coefficients[[0, -1]]
    shifts = (shifts + np.pi) % (2.0 * np.pi) - np.pi
    coefficients = spline.coefficients + (1.0 - step) * shifts[0] + step * shifts[1]
    turns = np.round((first - coefficients[0]) / (2.0 * np.pi))
    return replace(spline, coefficients=coefficients + 2.0 * np.pi * turns)


def _candidate(goals: Goals, label: str, splines: Sequence[JointSpline]) -> Candidate:
    """The motion or the cycle of these splines."""
    return Candidate.of(goals, label, "optimal control", [each.trajectory() for each in splines])


def _ways(goals: Goals) -> tuple[list[Robots], list[int], list[Robots]]:
    """The robots of each way in the scene's model and in a fuller one, the programmes' cases, and the robots of the first motions."""
    scenes = [each.scene for each in goals.ways]
    fuller = [each for scene in scenes if (each := fuller_scene(scene)) is not None]
    cases = goals.cases(PAYLOADS[0])
    nodes, few = nodes_of(cases[0], optimal_control.NODES), nodes_of(cases[0], FEW)
    ways = [robots_of(scene, each) for scene, each in zip(scenes, cases, strict=True)]
    first: list[Robots] = [[robots[k] for k in few] for robots in ways]
    if fuller:
        cases = goals.cases(PAYLOADS[1])
        nodes += [len(ways[0]) + k for k in nodes_of(cases[0], FULLER_NODES)]
        pairs = zip(fuller, cases, strict=True)
        ways = [robots + robots_of(*each) for robots, each in zip(ways, pairs, strict=True)]
    return [*ways], nodes, first


def robots_of(scene: Scene, variations: Sequence[Variation]) -> list[RobotVariant]:
    """The robots of a scene within the bands; equal variations are one robot."""
    robots = {each: each.robot(scene) for each in variations}
    return [robots[each] for each in variations]


def corrections(judged: Assessment) -> Mapping[str, float]:
    """Factors by which limits of the programmes have to be tighter after a motion's runs, and by how much ``clearance`` [m].

    They are below 1 for what a motion within all limits leaves of those that bind it, empty if that is little, and if a motion is too far
    off: through a wall, or where distances from the path are limited.
    """
    shares = {use.figure: use.share for use in judged.uses}
    if judged.feasible:
        left, binding = max(shares["residual"], 0.5) / FULL_RESIDUAL, ("torque", *LOADS)
        active = {name: share / FULL for name, share in shares.items() if name in binding and ACTIVE < share < FULL}
        return {**active, "residual": left} if left < FULL_RESIDUAL else {}
    missed, found = {use.figure: use for use in judged.missed}, dict[str, float]()
    clearance = missed.pop("clearance", None)
    if "off_path" in missed or (clearance is not None and clearance.value > optimal_control.DEPTH):
        return {}
    for name in missed:
        limit = {"motor_speed": "speed", "loop_residual": "residual"}.get(name, name)
        # programmes don't see an excess of the residual below half a percent
        least = SURE * shares[name] if limit == "residual" else min(SURE * shares[name], 2.0 * shares[name] - 0.999)
        found[limit] = max(found.get(limit, 1.0), least)
    return found if clearance is None else {**found, "clearance": SURE * clearance.value - clearance.limit}


def fuller_scene(scene: Scene) -> Scene | None:
    """The scene with the effects that lower its lowest frequencies; None for a rigid robot, or if it has them all."""
    effects = scene.effects
    if not effects.proximal_bending + effects.proximal_axial + effects.distal_bending + effects.distal_axial:
        return None
    # one shape of the distal links' bending is all that the lowest modes see
    shortening = effects.foreshortening or True
    changes = {"beam": "timoshenko", "foreshortening": shortening, "distal_bending": max(1, effects.distal_bending)}
    fuller = scene.replace({f"effects.{key}": value for key, value in changes.items()})
    return fuller if fuller.effects != effects else None


def nodes_of(variations: Sequence[Variation], count: int) -> list[int]:
    """Indices of a number of payloads, and of three for each other stiffness or damping."""
    payloads = sum(each.stiffness == each.damping == 1.0 for each in variations)
    first, others = (optimal_control.spread(payloads, min(n, payloads)) for n in (count, 3))
    return [*first, *(k + n for k in range(payloads, len(variations), payloads) for n in others)]


def limited(goals: Goals, given: Assessment, of_ways: Sequence[Robots]) -> MotionProblem:
    """The problem from the first motions on with the goals' limits in numbers, for each robot relative to what the given motion or cycle needs
    in the same model."""
    share, clear, quiet = RESERVE
    limits, drives = {name: goals.limit(name, np.full(2, given.worst(name))) for name in RATES}, goals.drives
    if drives is not None and "motor_speed" in goals.limits:
        largest = np.array([each.maximum_speed / each.gear_ratio for each in drives.motors])
        largest *= goals.limit("motor_speed", given.values["motor_speed"].max(axis=0))
        limits["speed"] = np.minimum(limits["speed"], largest)
    names = ["torque", *(name for name in LOADS if name in goals.limits)]
    needs = [_given_needs(*each, names) for each in zip(goals.ways, of_ways, strict=True)]
    time = sum(each.given.once.duration + each.pause for each in goals.ways)
    for name in names:
        # the largest of all ways, or their sum
        usual = (np.sum if name in OF_CYCLE else np.max)([each[name] for each in needs], axis=0)
        if name in ROOTS:
            usual = np.sqrt(usual * weight_of_squares(name, time, drives)[0])
        limits[name] = share * goals.limit(name, usual)
    ways = [
        Way(robots, _spline(each.first_motion), each.clearance.of_ways, each.pause)
        for each, robots in zip(goals.ways, of_ways, strict=True)
    ]
    residual, clearance = quiet * goals.wishes.residual, -clear * goals.wishes.margin
    return MotionProblem(ways, limits, residual, clearance, goals.wishes.settled_within, drives)


def _given_needs(goals: Goals, robots: Robots, names: Sequence[str]) -> dict[str, RealArray]:
    """What the given motion needs of loads, by name, in each case."""
    joints, (fleet, cases) = goals.given.once.joints, fleet_of(robots)
    first, last = joints.evaluate([0.0, joints.duration], 0, "right")[0]
    link_loads = tuple(name for name in LINK_LOADS if name in names)
    # torques of the pause are those of a robot that still swings, as in the FMU
    swinging = SHARED * int(GIVEN_STEPS / SHARED * min(goals.pause / joints.duration, SWINGING))
    elastic = ElasticResponse(fleet, first, GIVEN_STEPS + swinging, link_loads, COMPARED, SHARED)
    duration = joints.duration * (1.0 + swinging / GIVEN_STEPS)
    references = np.hstack(list(joints.evaluate(elastic.fractions * duration, 2, "left")))
    holding = joined([model.rest(last).torque for model in elastic.models])
    still = goals.pause + joints.duration - duration
    loads = Loads(elastic.respond(references, duration), holding, still, goals.drives, link_loads)
    return {name: loads.need(name, 3 * GIVEN_STEPS)[cases] for name in names}


def flexible(judge: Judge, found: Sequence[Assessment], processes: int, show: ShowProgress) -> Iterator[Candidate]:
    """Yield the motion with references for the flexible robot on the given path, corrected until limits hold over the bands.

    Arguments as for `planner.Method`.

    Raises:
        InputError: the given motion is a table.
        TrajectoryError: there are no such references.
        EquilibriumError: a robot's elastic motion has no solution.
    """
    goals = judge.goals
    if isinstance(goals.scene.trajectory, TableSection):
        raise InputError(
            f"scene {goals.scene.name} has a motion from a table, and references for the flexible robot follow a path"
        )
    # the path alone
    scene = goals.scene.replace({"shaper": [], "trajectory.references": None, **ONCE})
    show("references for the flexible robot on the given path", None)
    motion = plan_rigid(scene.replace({"trajectory.duration": goals.given.once.duration - 2.0 * LEAD}))
    motors = flexible_references(
        scene, motion.task, motion.joints, min(CORRECTED_AT, motion.duration / LEAST_PARTS)
    ).motors
    variations = goals.variations(CORRECTED_FOR)
    robots = robots_of(goals.scene, variations)
    problem = limited(goals, found[0], [robots])
    # near the path, and where a robot isn't, hardly further away
    response = ElasticResponse(robots, motors.coefficients[0], motors.intervals, (), COMPARED, SHARED)
    places = response.of_motion(motors, derivatives=False).position
    width = max(NEAR_PATH * goals.wishes.margin, -GROWTH * float(_within(goals, 0.0, places)[0].min()))
    ways = [replace(problem.ways[0], start=motors, distances=partial(_within, goals, width))]
    problem = replace(problem, ways=ways, clearance=0.0, residual=QUIET * goals.wishes.residual)
    nodes = nodes_of(variations, optimal_control.NODES)

    def made(motions: Sequence[JointSpline], note: str = "") -> Candidate:
        label = f"flexible references on the given path{note}"
        return Candidate(label, "flexible references", scene, motions[0].trajectory())

    improver = Improver(judge, made, nodes, "limits", show)
    tried = improver.best(("flexible",), problem)
    # without a correction the FMU judges whether they do
    yield made([motors], ", for the nominal payload") if tried is None else made(tried[0])


def _within(goals: Goals, width: float, points: RealArray) -> tuple[RealArray, RealArray]:
    """Distances (1, ...) [m] of points (..., 2) from leaving a strip along the given path, half as wide as given, and gradients (1, ..., 2)."""
    distance, gradient = goals.path.distance(points.reshape(-1, 2))
    away = np.sign(distance)[:, np.newaxis] * gradient
    return (width - np.abs(distance)).reshape(1, *points.shape[:-1]), -away.reshape(1, *points.shape)
