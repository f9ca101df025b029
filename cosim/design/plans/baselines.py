"""Motions to compare with: those of ruckig and toppra within the same limits, and a user's own from a CSV file.

Both planners know a rigid robot: ruckig limits of speed, acceleration and jerk, toppra those of speed, acceleration and torque.
Their motions are slowed down until the flexible robot's FMU keeps to these limits.

Sources: see `flexfmu.trajectories.sources`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from flexfmu.cosim.design.effects.choice import resolved
from flexfmu.cosim.design.plans.assessment import INSTANTS, Assessment, Candidate, Method
from flexfmu.cosim.design.plans.checks import INSTANTS as CHECKED
from flexfmu.cosim.design.plans.goals import RATES, Goals, peak_rates
from flexfmu.cosim.design.plans.quick_runs import JointMotion
from flexfmu.cosim.design.plans.scoring import Score
from flexfmu.cosim.design.plans.sequential_programme import MotionStudy
from flexfmu.cosim.design.plans.studies import study_of
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.showing import ShowProgress
from flexfmu.cosim.experiment.planning import plan, plan_own
from flexfmu.model.numeric import inverse_dynamics
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.own import OwnMotion, as_trajectory
from flexfmu.trajectories.piecewise import PiecewisePolynomial
from flexfmu.trajectories.sources import from_ruckig, from_toppra
from flexfmu.trajectories.table_file import read_table
from flexfmu.trajectories.trajectory import Trajectory

BASELINES = ("ruckig", "toppra")
"""Planners to compare with, names of extras too."""

ORDERS = {"speed": 1, "acceleration": 2, "torque": 2, "jerk": 3}
"""Limits that a slower motion keeps → power of the time_scale with which they grow; torques, with gravity, grow more slowly."""

UNLIMITED = 1e6
"""In place of a limit that isn't wished [rad, s]."""

KNOWN = {"ruckig": ("speed", "acceleration", "jerk", "torque"), "toppra": ("speed", "acceleration", "torque")}
"""Limits to which each planner's motion is slowed down first."""

SPARE, PRECISION = 1e-3, 1e-3
"""Share of a duration by which a slower motion is longer than estimated, and precision of the duration."""

PAYLOADS, STEP = 7, 1e-3
"""Payloads within the band, and communication step [s], with which durations are tried."""

PLACES, GRID = 121, 241
"""Places on the path through which toppra's spline goes, and its grid points."""

NEAR = 1e-4
"""Share of the crossing to both sides of its middle, between which the direction there is found."""

SAME_PLACE = 1e-5
"""Distance [m] within which a user's motion starts and ends where the scene's does."""


def installed() -> tuple[str, ...]:
    """The baselines whose package is installed."""
    return tuple(name for name in BASELINES if find_spec(name) is not None)


def ruckig(goals: Goals, found: Sequence[Assessment], processes: int, show: ShowProgress) -> Iterator[Candidate]:
    """Jerk-limited motion of the joints by way of the corners above start and end, where it stops.

    Raises:
        InputError: ruckig isn't installed.
    """
    yield from _baseline("ruckig", "from corner to corner", goals, _ruckig, show)


def toppra(goals: Goals, found: Sequence[Assessment], processes: int, show: ShowProgress) -> Iterator[Candidate]:
    """The fastest motion along the given path.

    Raises:
        InputError: toppra isn't installed.
        TrajectoryError: toppra finds no motion.
    """
    yield from _baseline("toppra", "the given path", goals, _toppra, show)


def file_candidate(scene: Scene, path: Path) -> Candidate:
    """A user's motion from a CSV file, of the joints or the end effector, to be judged beside those found.

    Raises:
        TrajectoryError: the file can't be read, or its motion can't be used; the message names line, column and value.
        InputError: the motion starts or ends elsewhere than the scene's.
    """
    return own_candidate(scene, path.name, read_table(path).trajectory())


def own_candidate(scene: Scene, name: str, motion: OwnMotion | Trajectory) -> Candidate:
    """A user's motion, to be judged beside those found.

    Raises:
        TrajectoryError: the motion can't be used.
        InputError: it starts or ends elsewhere than the scene's.
    """
    scene = _plain(resolved(scene))
    given, own = plan(scene).once.task, plan_own(scene, motion).task
    for verb, time, usual in (("starts", 0.0, 0.0), ("ends", own.duration, given.duration)):
        here, wanted = own.evaluate([time], 0, "left")[0, 0], given.evaluate([usual], 0, "left")[0, 0]
        if np.hypot(*(here - wanted)) > SAME_PLACE:
            raise InputError(
                f"the motion {name} {verb} at ({here[0]:.6g}, {here[1]:.6g}) m, that of scene {scene.name} at "
                f"({wanted[0]:.6g}, {wanted[1]:.6g}) m: move it there"
            )
    return Candidate(name, "csv", scene, as_trajectory(motion))


def _baseline(
    name: Method, way: str, goals: Goals, design: Callable[[Goals, MotionStudy], PiecewisePolynomial], show: Any
) -> Iterator[Candidate]:
    """What a planner finds, slowed down until the flexible robot keeps to the limits that the planner knows of, then to all."""
    if name not in installed():
        raise InputError(f'the motion of {name} needs its package: pip install "flexfmu[{name}]"')
    show(f"{name}: {way}", None)
    study, scene = study_of(goals, PAYLOADS, STEP), _plain(goals.scene)
    most = _limits(goals)
    quick = _slowed(design(goals, study), study, KNOWN[name], most)
    yield Candidate(f"{name}, {way}", name, scene, quick)
    # limits of which the planner knows nothing, such as the jerk for toppra
    slow = _slowed(quick, study, tuple(ORDERS), most)
    if slow.duration > quick.duration:
        yield Candidate(f"{name}, {way}, slower", name, scene, slow)


def _slowed(
    motion: PiecewisePolynomial, study: MotionStudy, limits: Collection[str], most: RealArray
) -> PiecewisePolynomial:
    """The motion as fast as the limits allow, by bisection of its duration on quick runs of the FMU.

    Args:
        motion: the motion.
        study: the robots and their limits of torque.
        limits: names of the limits to keep to.
        most: limits of speed, acceleration and jerk [rad, s].
    """

    def time_scale(duration: float) -> float:
        timed, times = motion.with_duration(duration), np.linspace(0.0, duration, study.robot.steps(duration) + 1)
        run = study.robot.run(JointMotion(times, timed.evaluate(times, 2, "left")))
        # rates as plans are judged
        uses = dict(zip(RATES, peak_rates(timed, INSTANTS) / most, strict=True))
        uses["torque"] = Score(run, study.bounds).uses["torque"]
        return float(max(uses[name] ** (1.0 / ORDERS[name]) for name in limits))

    # a duration that is long enough, and one that isn't
    short = long = motion.duration
    while (slower := time_scale(long)) > 1.0:
        short, long = long, long * slower * (1.0 + SPARE)
    while long - short > PRECISION * long:
        middle = 0.5 * (short + long)
        short, long = (middle, long) if time_scale(middle) > 1.0 else (short, middle)
    return motion.with_duration(long)


def _plain(scene: Scene) -> Scene:
    """The scene without shapers and references for the flexible robot, which belong to its own motion."""
    return scene.replace({"shaper": [], "trajectory.references": None})


def _limits(goals: Goals) -> RealArray:
    """Limits of speed, acceleration and jerk of the joints [rad, s]."""
    peaks = peak_rates(goals.given.once.joints, CHECKED)
    return np.array([goals.limit(name, usual, UNLIMITED) for name, usual in zip(RATES, peaks, strict=True)])


def _ruckig(goals: Goals, study: MotionStudy) -> PiecewisePolynomial:
    """From start to end with stops at the corners above, past the middle between these as fast as pays."""
    limits, (start, end) = _limits(goals), goals.trace[[0, -1]]
    along = (end - start) / np.hypot(*(end - start))
    # from the chord to the height of the path
    rise = goals.trace - start - np.outer((goals.trace - start) @ along, along)
    top = rise[np.hypot(*rise.T).argmax()]
    before, middle, after = (start + top + share * (end - start) for share in (0.5 - NEAR, 0.5, 0.5 + NEAR))
    places = _joints(goals, np.array([start, start + top, before, middle, after, end + top, end]))
    direction = places[4] - places[2]
    direction /= np.abs(direction).max()
    rest = np.zeros(2)

    def crossing(speed: float) -> list[PiecewisePolynomial]:
        past = speed * direction
        return [_section(places[1], rest, places[3], past, limits), _section(places[3], past, places[5], rest, limits)]

    # as fast as pays: the two sections together are shortest
    fastest = minimize_scalar(
        lambda speed: sum(each.duration for each in crossing(speed)), bounds=(0.0, limits[0]), method="bounded"
    )
    first, last = _section(places[0], rest, places[1], rest, limits), _section(places[5], rest, places[6], rest, limits)
    return _joined([first, *crossing(float(fastest.x)), last])


def _section(
    start: RealArray, speed: RealArray, end: RealArray, last: RealArray, limits: RealArray
) -> PiecewisePolynomial:
    """The fastest motion between two states, positions [rad] and speeds [rad/s], without acceleration at either."""
    import ruckig as library

    wanted, found = library.InputParameter(2), library.Trajectory(2)
    wanted.current_position, wanted.current_velocity = start.tolist(), speed.tolist()
    wanted.target_position, wanted.target_velocity = end.tolist(), last.tolist()
    wanted.max_velocity, wanted.max_acceleration, wanted.max_jerk = (2 * [limit] for limit in limits.tolist())
    outcome = library.Ruckig(2).calculate(wanted, found)
    if outcome != library.Result.Working:
        raise TrajectoryError(f"ruckig finds no motion: {outcome}")
    return from_ruckig(found)


def _joined(parts: Sequence[PiecewisePolynomial]) -> PiecewisePolynomial:
    """Cubic motions one after the other."""
    starts = np.concatenate([[0.0], np.cumsum([each.duration for each in parts])])
    knots = [each.knots[:-1] + start for each, start in zip(parts, starts[:-1], strict=True)]
    taylor = np.concatenate([each.coefficients for each in parts], axis=1)
    return PiecewisePolynomial(np.append(np.concatenate(knots), starts[-1]), taylor, "joints")


def _toppra(goals: Goals, study: MotionStudy) -> PiecewisePolynomial:
    """Along the given path, within the torques of the rigid robot at the robots of the bands."""
    import toppra as library
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointAccelerationConstraint, JointTorqueConstraint, JointVelocityConstraint

    library.setup_logging("ERROR")
    logging.getLogger("toppra").setLevel(logging.ERROR)
    # limits of both joints
    speed, acceleration, _ = ([[-limit, limit]] * 2 for limit in _limits(goals).tolist())
    constraints = [JointVelocityConstraint(speed), JointAccelerationConstraint(acceleration)]
    if "torque" in goals.limits:
        for robot, most in zip(goals.variations(PAYLOADS), study.bounds.torque, strict=True):
            rigid = partial(_torques, inverse_dynamics(robot.of(goals.scene)))
            constraints.append(JointTorqueConstraint(rigid, np.stack([-most, most], axis=1), np.zeros(2)))
    # the given path, by its length
    places = _joints(goals, goals.trace[:: (len(goals.trace) - 1) // (PLACES - 1)])
    length = np.linspace(0.0, 1.0, len(places))
    path = library.SplineInterpolator(length, places)
    algorithm = TOPPRA(constraints, path, gridpoints=np.linspace(0.0, 1.0, GRID), parametrizer="ParametrizeSpline")
    return from_toppra(algorithm.compute_trajectory(0, 0))


def _torques(rigid: Any, q: RealArray, v: RealArray, a: RealArray) -> RealArray:
    """Torques of the rigid robot (2,) [N.m]."""
    return np.asarray(rigid(q, v, a).full())[:, 0]


def _joints(goals: Goals, points: RealArray) -> RealArray:
    """Continuous joint angles (N, 2) [rad] at places (N, 2) [m], from those at the start of the motion on."""
    angles = np.unwrap([goals.given.kinematics.inverse(tuple(point)) for point in points], axis=0)
    start = goals.given.once.joints.evaluate([0.0], 0)[0, 0]
    return np.asarray(angles + 2 * np.pi * np.round((start - angles[0]) / (2 * np.pi)))
