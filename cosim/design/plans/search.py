"""Searches corners, time laws, durations and shapers within limits that hold for all robots of the bands.

Motions whose corners and shapers have the same kinds are a family. Its numbers (lift, size of the corners, shape of the time law, frequencies of
the shapers) and the duration are variables of a motion that optimal control improves; the derivatives of references are differences.

Every combination of shapers is improved a little for few robots on short grids; the best families go on, also with other corners and from a
second start. The best motion is then improved for all robots until the FMU finds its limits kept. The result doesn't depend on the number of
processes.

A path is tabulated once by its arc length, with the joint angles and two derivatives; every time law, duration and shaper on it
then costs a millisecond.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial, reduce
from itertools import zip_longest
from math import fsum, log
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge
from flexfmu.cosim.design.plans.goals import Goals
from flexfmu.cosim.design.plans.optimal import PAYLOADS, Improver, limited, nodes_of, robots_of
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.showing import ShowProgress
from flexfmu.cosim.many.executor import mapping
from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.reference_design.optimal_control import NODES, Aim, MotionProblem, Stage
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.model.statics import damped_modes
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.path import BLENDS, PickAndPlacePath
from flexfmu.trajectories.piecewise import PiecewisePolynomial, spline
from flexfmu.trajectories.shapers.designs import design as design_shaper
from flexfmu.trajectories.shapers.sequence import UNSHAPED, ImpulseSequence, Oscillator

SINGLE = ("zv", "zvd", "ei", "zvdd", "2-hump-ei")
"""Shapers for the lowest mode."""

PAIRS = (("zv", "zv"), ("zvd", "zv"), ("zv", "zvd"), ("zvd", "zvd"), ("ei", "ei"), ("zvdd", "zvd"))
"""Shapers for the two lowest modes."""

CORNERS = ("lame", "polar")
"""Kinds of corners; combinations of shapers are compared with the first one. Clothoids and other time laws than polynomials with as many
numbers win on no robot that was tried."""

ROUNDS = (3, 1, 5), (5, 2, 8), (7, 2, 10)
"""Payloads, steps of the integration in each part of a motion, and programmes of each round."""

KEPT, LAST = 3, 2
"""Families that go on after the first round, and after the second one."""

SPREAD = 0.15
"""Standard deviation of a family's second start, in each number but those of the time law, relative to its range."""

STRETCH, STRETCHES = 1.4, 5
"""Factor by which a first motion is slower where there is none, or none that nearly meets limits in the end, and how often."""

NEARLY, INFEASIBLE = 0.01, 10.0
"""Violation up to which limits count as met, half as much again of the residual vibration, and what others cost more."""

WORTH = 2.0
"""Weight of the violations of limits beside the logarithm of what is minimised."""

MOST_MODES, NEIGHBOURHOOD = 2, 3.0
"""Modes that shapers are designed for: at most so many, with frequencies up to this multiple of the lowest."""

LOWEST, HIGHEST, LEAST_CORRIDOR = 0.6, 2.0, 1e-6
"""Range of the path's height, as multiples of the given one, where the given motion's way doesn't bound it, and the smallest range where it does [m]."""

PATHS = ((0.7, 0.8, 0.5), (1.0, 1.0, 0.1), (0.2, 0.8, 0.5))
"""Height, and height and width of the corners to begin with, from the smallest, 0, to the largest, 1: usual ones, and what goes around walls."""

NONE = 1e-2
"""Limit of the residual vibration of trials, relative to the wish, where it is what is minimised."""

TABULATED = 400
"""Nodes of a tabulated path; quintics between them are exact to 1e-9 rad."""

SHAPE = 2.5
"""Largest magnitude of the numbers of `polynomial`."""

USUAL_SHAPE = (0.0, 0.16, 0.0, 0.17, 0.0, -0.04, 0.0, 0.1)
"""Those with which its velocity is about that of a modified trapezoid."""

LAW = slice(3, 3 + len(USUAL_SHAPE))
"""Places of the time law's numbers among those of a motion."""

SLOWEST, PLACES = 0.03, np.linspace(-1.0, 1.0, 41)
"""Smallest value of that shape, for a motion that doesn't stop on its way, and places where it is examined."""

LEAST_TALL, NARROWEST = 0.3, 0.3
"""Smallest height of a corner, as a fraction of the path's, and smallest width, as a fraction of its height."""

FREQUENCIES, USUAL_FREQUENCY = (0.8, 1.3), 1.05
"""Range of the frequencies that shapers are designed for, as multiples of those at the end pose: along the path they differ. And the first ones."""

LEAST_TIME = 0.05
"""Smallest part of the total time that a motion without shapers takes."""

INTERVALS, LONGEST = 48, 0.01
"""Least number of parts of a motion, and longest one [s]."""

DIFFERENCE = 1e-3
"""Change of a number, and relative one of the duration, for derivatives."""

ShaperChoice = tuple[str, Oscillator]
"""A shaper of the joint references: key of `flexfmu.trajectories.shapers.designs.SHAPERS`, and its mode."""


Found = tuple[list[float], float] | None
"""What a journal has of a family's motion: its variables and cost."""


def search(judge: Judge, found: Sequence[Assessment], processes: int, show: ShowProgress) -> Iterator[Candidate | str]:
    """Yield ever better motions.

    Args:
        judge: knows limits, bands and clearance.
        found: the given motion, and what else was assessed.
        processes: number of processes; the motions don't depend on it.
        show: is called with what is being done, and the finished fraction.

    Raises:
        InputError: the scene's motion has no path.
        BuildError, EquilibriumError, TrajectoryError: the robot can't be run, or its given motion.
    """
    show("search: modes and limits", 0.0)
    goals, journal, going = judge.goals, judge.journal, families(judge.goals)
    variations, aim = goals.variations(PAYLOADS[0]), goals.wishes.minimise
    problem = limited(goals, found[0], [robots_of(goals.scene, variations)])
    best, random = list[FamilyMotion](), np.random.default_rng(goals.wishes.seed)
    with mapping(partial(improved, problem, aim), processes) as work:
        for number, (payloads, parts, programmes) in enumerate(ROUNDS):
            cases, ranked = np.array(nodes_of(variations, payloads)), list[tuple[float, int, FamilyMotion]]()
            new = [each for k, each in enumerate(going) if ("search", number, k) not in journal]
            made = work([(each, cases, parts, programmes) for each in new])
            for k, motion in enumerate(going):
                if trial := journal.kept(("search", number, k), Found, partial(next, made)):
                    variables, cost = trial
                    ranked.append((cost, k, motion.moved(np.array(variables) - motion.variables)))
                done = number + (k + 1) / len(going)
                show(f"search: round {number + 1} of {len(ROUNDS)}", done / (len(ROUNDS) + 1))
            best = [motion for _, _, motion in sorted(ranked)]
            going = best[:LAST]
            if number == 0 and best:
                # with the other corners, and from a start whose path and frequencies differ a little
                others = [replace(each, blend=CORNERS[1]) for each in best[:LAST]]
                spread = SPREAD * random.standard_normal(len(best[0].numbers)) * np.ptp(best[0].bounds, axis=0)
                spread[LAW] = 0.0
                going = [*best[:KEPT], *others, best[0].moved(np.append(spread, 0.0))]
    if not best:
        raise TrajectoryError(f"scene {goals.scene.name}: no motion of the search can be planned")

    def candidate(motions: Sequence[FamilyMotion]) -> Candidate:
        return Candidate(motions[0].label, "search", goals.scene.replace(motions[0].changes))

    # the best ones for all robots until one keeps all limits, and slower ones where there is no motion
    improver = Improver(judge, candidate, nodes_of(variations, NODES), aim, show)
    is_free, last = goals.wishes.duration is None, None
    starts = [(each, 1.0) for each in best] + [(best[0], STRETCH**k) for k in range(1, STRETCHES) if is_free]
    for number, (first, slower) in enumerate(starts):
        if last and (last[1].feasible or slower > 1.0):
            break
        last = (yield from improver.refined(("search", number), problem.begun([first], slower))) or last


def improved(problem: MotionProblem, aim: Aim, task: tuple[FamilyMotion, NDArray[np.intp], int, int]) -> Found:
    """A motion of a family after some programmes for some robots, with its cost; None if there is none.

    Args:
        problem: limits and robots.
        aim: what is minimised.
        task: the first motion, cases, steps of the integration in each part, and programmes.
    """
    motion, cases, parts, programmes = task
    problem = problem.tightened({"residual": 1.0 / NONE} if aim == "residual" else {}).of_cases(cases)
    for _ in range(STRETCHES):
        try:
            *_, state = Stage(problem, (motion,), parts, aim).improvements(programmes)
        except (TrajectoryError, EquilibriumError):
            if aim != "time":
                return None
            # a slower one may do
            motion = motion.with_duration(STRETCH * motion.duration)
            continue
        (found,), missed = state.motions, state.violations.values()
        load = "rms_torque" if aim == "residual" else aim
        effort = found.duration if aim == "time" else float(state.ways[0].loads.need(load).max())
        cost = log(effort) + WORTH * sum(missed) + (INFEASIBLE if max(missed) > NEARLY else 0.0)
        return found.variables.tolist(), cost
    return None


def families(goals: Goals) -> list[FamilyMotion]:
    """First motions with all combinations of shapers and the first kind of corners.

    Raises:
        InputError: the scene's motion is a table.
        EquilibriumError: the robot can't rest at the end.
    """
    scene, section, wishes = goals.scene, goals.scene.trajectory, goals.wishes
    if not isinstance(section, TrajectorySection):
        raise InputError(f"scene {scene.name} has a motion from a table, and no path whose corners could change")
    # modes at the end of the motion
    found = damped_modes(scene, goals.given.once.end_pose[0])
    pairs = zip(found.frequencies[:MOST_MODES], found.ratios[:MOST_MODES], strict=True)
    modes = [Oscillator(float(f), float(z)) for f, z in pairs if f <= NEIGHBOURHOOD * found.frequencies[0]]
    shapers: list[tuple[ShaperChoice, ...]] = [(), *(((kind, modes[0]),) for kind in SINGLE if modes)]
    if len(modes) > 1:
        shapers += [((a, modes[0]), (b, modes[1])) for a, b in PAIRS]
    # heights
    heights = LOWEST * section.height, HIGHEST * section.height
    if wishes.keep_out is None:
        heights = section.height, section.height + max(wishes.corridor, LEAST_CORRIDOR)
    usual = wishes.duration or goals.given.once.duration
    intervals = max(INTERVALS, round(usual / LONGEST))

    def family(path: tuple[float, float, float], chosen: tuple[ShaperChoice, ...]) -> FamilyMotion:
        motion = FamilyMotion(scene.mechanism, section, heights, CORNERS[0], chosen, np.zeros(0), usual, intervals)
        low, high = motion.bounds[:, : LAW.start]
        numbers = [*(low + (high - low) * path), *USUAL_SHAPE, *[USUAL_FREQUENCY] * len(chosen)]
        return replace(motion, numbers=np.array(numbers))

    # the path that has least to go around
    path = min(PATHS, key=lambda each: goals.clearance.passage(family(each, ()).points))
    return [family(path, each) for each in shapers]


@lru_cache(maxsize=1024)
def _sequence(choice: ShaperChoice) -> ImpulseSequence:
    """The impulses of a shaper.

    Raises:
        TrajectoryError: there is no such shaper for this damping.
    """
    return design_shaper(choice[0], [choice[1]])


@lru_cache(maxsize=256)
def polynomial(shape: tuple[float, ...]) -> tuple[float, ...]:
    """Coefficients of a time law with the velocity c (η(1 - η))² (1 + Σ shape_k P_k(2η - 1)), with Legendre polynomials from k = 1.

    It is at rest with zero acceleration at both ends; without a shape it is the polynomial of fifth degree.
    """
    law: RealArray = _laws(len(shape)) @ [1.0, *shape]
    law /= law.sum()
    # large coefficients of both signs leave rounding errors of the end, which small ones take back
    place, slope = fsum(law) - 1.0, fsum(law * np.arange(len(law)))
    law[2:4] += [slope - 3.0 * place, 2.0 * place - slope]
    return tuple(law.tolist())


@lru_cache
def _laws(count: int) -> RealArray:
    """Coefficients (count + 6, count + 1) of the integrals of (η(1 - η))² P_k(2η - 1) for k = 0 to ``count``."""
    ends = np.polynomial.Polynomial([0.0, 0.0, 1.0, -2.0, 1.0])
    waves = [np.polynomial.Legendre.basis(k, domain=[0.0, 1.0]).convert(kind=type(ends)) for k in range(count + 1)]
    return np.array([*zip_longest(*((wave * ends).integ().coef for wave in waves), fillvalue=0.0)])


@lru_cache(maxsize=16)
def path_table(mechanism: Mechanism, path: PickAndPlacePath) -> PiecewisePolynomial:
    """Joint angles [rad] by the arc length [m] of a path.

    Raises:
        TrajectoryError: the path leaves the workspace.
    """
    nodes = np.union1d(np.linspace(0.0, path.length, TABULATED), path.knots)
    x, y = path.jets(nodes, 2)
    kinematics = RigidKinematics(mechanism)
    # within the workspace, away from singularities
    for margin in kinematics.margins(np.stack([x.value, y.value], axis=-1)):
        if not (margin.values >= margin.required).all():
            raise TrajectoryError(f"{margin.name} is too small along the path")
    values = np.stack([joint.derivatives() for joint in kinematics.joints(x, y)], axis=-1)
    values[0] = np.unwrap(values[0], axis=0)
    return spline(nodes, values, coordinates="joints")


@dataclass(frozen=True, eq=False)
class FamilyMotion:
    """A motion of a family; its variables as a `flexfmu.model.reference_design.joint_spline.DesignedMotion` are its numbers and T.

    Attributes:
        mechanism, section: of the scene whose pick and place it goes between.
        heights: smallest and largest height of the path [m].
        blend: kind of the corners.
        shapers: kind of each, and its mode at the end of the motion.
        numbers: (n,): height of the path [m], that of the corners relative to it, their width from the narrowest, 0, to the widest, 1, shape of the
            time law, and frequencies of the shapers relative to those of the modes.
        duration: T with shapers [s].
        intervals: number of equal parts of the duration.
    """

    mechanism: Mechanism
    section: TrajectorySection
    heights: tuple[float, float]
    blend: str
    shapers: tuple[ShaperChoice, ...]
    numbers: RealArray
    duration: float
    intervals: int = INTERVALS

    @cached_property
    def path(self) -> PickAndPlacePath:
        """The path.

        Raises:
            TrajectoryError: it isn't feasible.
        """
        height, tall, wide = self.numbers[: LAW.start].tolist()
        tall, widest = tall * height, 0.5 * self.section.width
        narrowest = min(NARROWEST * tall, widest)
        corner = BLENDS[self.blend].make(tall, narrowest * (widest / narrowest) ** wide)
        return PickAndPlacePath(self.section.start, self.section.lift, height, self.section.width, corner)

    @property
    def points(self) -> RealArray:
        """Points of the path (N, 2) [m]; errors as of `path`."""
        x, y = self.path.jets(np.linspace(0.0, self.path.length, TABULATED), 0)
        return np.stack([x.value, y.value], axis=-1)

    @property
    def law(self) -> tuple[float, ...]:
        """Coefficients of the time law, a polynomial."""
        return polynomial(tuple(self.numbers[LAW].tolist()))

    @cached_property
    def chosen(self) -> tuple[ShaperChoice, ...]:
        """The shapers with the frequencies that they are designed for."""
        pairs = zip(self.shapers, self.numbers[LAW.stop :].tolist(), strict=True)
        return tuple((kind, replace(mode, frequency=mode.frequency * multiple)) for (kind, mode), multiple in pairs)

    @cached_property
    def sequence(self) -> ImpulseSequence:
        """All impulses; errors as of `_sequence`."""
        return reduce(ImpulseSequence.convolve, map(_sequence, self.chosen), UNSHAPED)

    @property
    def unshaped_duration(self) -> float:
        """Duration without shapers [s].

        Raises:
            TrajectoryError: the shapers take longer than the motion.
        """
        if (found := self.duration - self.sequence.duration) < LEAST_TIME * self.duration:
            raise TrajectoryError("shapers take longer than the motion")
        return found

    @property
    def changes(self) -> dict[str, Any]:
        """Keys of the scene with their values; errors as of `evaluate`."""
        corner = self.path.blend
        return {
            "trajectory.height": self.path.height,
            "trajectory.blend": {"kind": self.blend, "height": corner.height, "width": corner.width},
            "trajectory.profile": {"kind": "polynomial", "coefficients": list(self.law)},
            "trajectory.duration": self.unshaped_duration,
            "shaper": [
                {"kind": kind, "modes": [{"frequency": mode.frequency, "ratio": mode.ratio}], "apply": "joints"}
                for kind, mode in self.chosen
            ],
        }

    @property
    def label(self) -> str:
        """Corners, time law and shapers in a line."""
        corner, shapers = self.path.blend, " x ".join(f"{kind} on joints" for kind, _ in self.shapers)
        size = f"{1e3 * corner.width:.0f} x {1e3 * corner.height:.0f} mm"
        return f"{self.blend} {size}, polynomial, {shapers or 'unshaped'}"

    @cached_property
    def bounds(self) -> RealArray:
        """The smallest and the largest numbers (2, n)."""
        law, shapers = [(-SHAPE, SHAPE)] * len(USUAL_SHAPE), [FREQUENCIES] * len(self.shapers)
        return np.array([self.heights, (LEAST_TALL, 1.0), (0.0, 1.0), *law, *shapers]).T

    @property
    def variables(self) -> RealArray:
        """The numbers and T."""
        return np.append(self.numbers, self.duration)

    @property
    def room(self) -> RealArray:
        """Largest changes of the variables: numbers stay within their bounds."""
        return np.column_stack([self.bounds - self.numbers, [-np.inf, np.inf]])

    def with_duration(self, duration: float) -> FamilyMotion:
        """Return the motion with another duration."""
        return replace(self, duration=duration)

    def moved(self, change: RealArray) -> FamilyMotion:
        """Return the motion after a change of its variables (n + 1,)."""
        numbers = np.clip(self.numbers + change[:-1], *self.bounds)
        return replace(self, numbers=numbers, duration=self.duration + float(change[-1]))

    def evaluate(self, fraction: ArrayLike, order: int = 2) -> RealArray:
        """Return joint angles with up to two derivatives (order + 1, N, 2) at fractions of the duration.

        Raises:
            TrajectoryError: the path or a shaper is not feasible, or the shapers take longer than the motion.
        """
        points = np.atleast_1d(np.asarray(fraction, dtype=float))
        table, duration, impulses = path_table(self.mechanism, self.path), self.unshaped_duration, self.sequence
        # arc length and its derivatives, delayed by each impulse; time laws are at rest at both ends
        eta = np.clip((points * self.duration - np.array(impulses.times)[:, None]) / duration, 0.0, 1.0)
        law = np.polynomial.Polynomial(self.law)
        fractions = np.stack([law.deriv(k)(eta.ravel()) if k else law(eta.ravel()) for k in range(3)])
        s, speed, change = fractions * table.duration / duration ** np.arange(3)[:, None]
        # joint angles by the chain rule, then the shapers' sum
        angle, slope, bend = table.evaluate(np.clip(s, 0.0, table.duration), 2)
        speed, change = speed[:, None], change[:, None]
        joints = np.stack([angle, slope * speed, bend * speed**2 + slope * change]).reshape(3, -1, points.size, 2)
        return np.asarray(np.einsum("j,kjni->kni", np.array(impulses.amplitudes), joints))[: order + 1]

    def derivatives(self, fractions: RealArray) -> RealArray:
        """Return derivatives (N, 6, n + 1) of [q_a, v_a, a_a] by the variables; zero by those that can't change."""
        here, found = self.evaluate(fractions), np.zeros((len(fractions), 6, len(self.variables)))
        # towards the middle of the bounds
        steps = DIFFERENCE * np.append(np.ptp(self.bounds, axis=0), self.duration)
        steps[:-1] *= np.where(self.numbers > self.bounds.mean(axis=0), -1.0, 1.0)
        for k, step in enumerate(steps.tolist()):
            change = np.zeros(len(steps))
            change[k] = step
            with suppress(TrajectoryError):
                found[..., k] = np.hstack(list((self.moved(change).evaluate(fractions) - here) / step))
        return found

    def rates(self, fractions: RealArray, references: RealArray, by: RealArray) -> list[tuple[RealArray, RealArray]]:
        """Return speeds, accelerations and mean jerks between the fractions (n, 2), and their derivatives (n, 2, n + 1)."""
        _, speed, acceleration = by.reshape(len(fractions), 3, 2, by.shape[2]).swapaxes(0, 1)
        times = self.duration * np.diff(fractions)[:, None]
        jerk, jerk_by = np.diff(references[2], axis=0) / times, np.diff(acceleration, axis=0) / times[..., None]
        jerk_by[..., -1:] -= jerk[..., None] / self.duration
        return [(references[1], speed), (references[2], acceleration), (jerk, jerk_by)]

    def conditions(self) -> tuple[RealArray, RealArray]:
        """Return by how much the time law's shape is below the smallest allowed, and the slopes by the variables."""
        waves = np.polynomial.legendre.legvander(PLACES, len(USUAL_SHAPE))[:, 1:]
        slopes = np.zeros((len(PLACES), len(self.variables)))
        slopes[:, LAW] = -waves
        return SLOWEST - 1.0 + slopes @ self.variables, slopes

    def measures(self, unit: float) -> tuple[RealArray, RealArray]:
        """Return the size of changes that count alike, from bound to bound and a usual duration [s], and the squared size (n + 1, n + 1) of changes
        of the acceleration, relative to the largest one, and of the duration."""
        fractions = np.linspace(0.0, 1.0, INTERVALS + 1)
        by = self.derivatives(fractions)[:, 4:, :-1].reshape(-1, len(self.numbers))
        by /= np.abs(self.evaluate(fractions)[2]).max()
        return np.append(np.ptp(self.bounds, axis=0), unit), block_diag(by.T @ by, [0.1 * INTERVALS / unit**2])
