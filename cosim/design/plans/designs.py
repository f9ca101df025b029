"""What a search may choose of a motion: corners, lift, time law and shapers, and the joint references that follow.

A path is tabulated once by its arc length, with the joint angles and two derivatives; every time law, duration and shaper on it
then costs a millisecond. Kinds of corners and shapers are a motion family, whose numbers are points of a unit cube. With the duration
they are the variables of a motion that optimal control improves: the derivatives of references are differences.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, reduce
from math import exp, fsum, log
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.curves import Point
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.path import BLENDS, PickAndPlacePath
from flexfmu.trajectories.piecewise import PiecewisePolynomial, spline
from flexfmu.trajectories.profiles import PROFILES, evaluate_profile
from flexfmu.trajectories.shapers.designs import design as design_shaper
from flexfmu.trajectories.shapers.sequence import UNSHAPED, ImpulseSequence, Oscillator

NODES = 400
"""Nodes of a tabulated path; quintics between them are exact to 1e-9 rad."""


ShaperChoice = tuple[str, Oscillator]
"""A shaper of the joint references: key of `flexfmu.trajectories.shapers.designs.SHAPERS`, and its mode."""


@lru_cache(maxsize=1024)
def _sequence(choice: ShaperChoice) -> ImpulseSequence:
    """The impulses of a shaper.

    Raises:
        TrajectoryError: there is no such shaper for this damping.
    """
    kind, mode = choice
    return design_shaper(kind, [mode])


@dataclass(frozen=True)
class Design:
    """A motion between the pick and the place of a scene.

    Attributes:
        blend: kind of the corners.
        corner: their height and width [m].
        height: of the lift [m].
        law: coefficients of the time law, a polynomial.
        shapers: all shapers.
        duration: without shapers [s].
    """

    blend: str
    corner: tuple[float, float]
    height: float
    law: tuple[float, ...]
    shapers: tuple[ShaperChoice, ...]
    duration: float

    @property
    def sequence(self) -> ImpulseSequence:
        """All impulses."""
        return reduce(ImpulseSequence.convolve, map(_sequence, self.shapers), UNSHAPED)

    @property
    def changes(self) -> dict[str, Any]:
        """Keys of the scene with their values."""
        height, width = self.corner
        return {
            "trajectory.height": self.height,
            "trajectory.blend": {"kind": self.blend, "height": height, "width": width},
            "trajectory.profile": {"kind": "polynomial", "coefficients": list(self.law)},
            "trajectory.duration": self.duration,
            "shaper": [
                {"kind": kind, "modes": [{"frequency": mode.frequency, "ratio": mode.ratio}], "apply": "joints"}
                for kind, mode in self.shapers
            ],
        }

    @property
    def label(self) -> str:
        """Corners, time law and shapers in a line."""
        height, width = self.corner
        shapers = " x ".join(f"{kind} on joints" for kind, _ in self.shapers) or "unshaped"
        return f"{self.blend} {1e3 * width:.0f} x {1e3 * height:.0f} mm, polynomial, {shapers}"


def references(scene: Scene, design: Design, time: RealArray) -> RealArray:
    """Joint references of a design, with two time derivatives, at instants (N,) [s]: (3, N, 2) [rad, rad/s, rad/s²].

    Raises:
        TrajectoryError: the path or a shaper is not feasible.
    """
    section = scene.trajectory
    assert isinstance(section, TrajectorySection)
    corner = design.blend, *design.corner
    table = path_table(scene.mechanism, section.start, section.lift, section.width, design.height, corner)
    # arc length and its derivatives, delayed by each impulse; time laws are at rest at both ends
    impulses = design.sequence
    eta = np.clip((time - np.array(impulses.times)[:, None]) / design.duration, 0.0, 1.0)
    fractions = evaluate_profile(_profile(design.law), eta.ravel(), 2).derivatives()
    length = table.duration
    s, speed, change = fractions * length / design.duration ** np.arange(3)[:, None]
    # joint angles by the chain rule, then the shapers' sum
    angle, slope, bend = table.evaluate(np.clip(s, 0.0, length), 2)
    speed, change = speed[:, None], change[:, None]
    joints = np.stack([angle, slope * speed, bend * speed**2 + slope * change])
    return np.asarray(np.einsum("j,kjni->kni", np.array(impulses.amplitudes), joints.reshape(3, -1, time.size, 2)))


@lru_cache(maxsize=16)
def path_table(
    mechanism: Mechanism, start: Point, lift: Point, width: float, height: float, corner: tuple[str, float, float]
) -> PiecewisePolynomial:
    """Joint angles [rad] by the arc length [m] of the path with these corners: kind, height and width [m].

    Other arguments as for `PickAndPlacePath`.

    Raises:
        TrajectoryError: the path is not feasible or leaves the workspace.
    """
    kind, *extent = corner
    path = PickAndPlacePath(start, lift, height, width, BLENDS[kind].make(*extent))
    nodes = np.union1d(np.linspace(0.0, path.length, NODES), path.knots)
    x, y = path.jets(nodes, 2)
    points = np.stack([x.value, y.value], axis=-1)
    # within the workspace, away from singularities
    kinematics = RigidKinematics(mechanism)
    for margin in kinematics.margins(points):
        if not (margin.values >= margin.required).all():
            raise TrajectoryError(f"{margin.name} is too small along the path")
    joints = [joint.derivatives() for joint in kinematics.joints(x, y)]
    values = np.stack(joints, axis=-1)
    values[0] = np.unwrap(values[0], axis=0)
    return spline(nodes, values, coordinates="joints")


@lru_cache(maxsize=256)
def _profile(law: tuple[float, ...]) -> Any:
    return PROFILES["polynomial"].make(coefficients=law)


def polynomial(shape: Sequence[float]) -> tuple[float, ...]:
    """Coefficients of a time law with the velocity c (η(1 - η))² (1 + Σ shape_k P_k(2η - 1)), with Legendre polynomials from k = 1.

    It is at rest with zero acceleration at both ends; without a shape it is the polynomial of fifth degree.
    """
    law = np.array([1.0, *shape]) @ _laws(len(shape))
    law /= law.sum()
    # large coefficients of both signs leave rounding errors of the end, which small ones take back
    place, slope = fsum(law) - 1.0, fsum(law * np.arange(len(law)))
    law[2:4] += [slope - 3.0 * place, 2.0 * place - slope]
    return tuple(law.tolist())


@lru_cache
def _laws(count: int) -> RealArray:
    """(count + 1, count + 6) coefficients of the integrals of (η(1 - η))² P_k(2η - 1)."""
    eta = np.polynomial.Polynomial([0.0, 1.0])
    found = np.zeros((count + 1, count + 6))
    for k in range(count + 1):
        wave = np.polynomial.Legendre.basis(k, domain=[0.0, 1.0]).convert(kind=np.polynomial.Polynomial)
        law = ((eta * (1.0 - eta)) ** 2 * wave).integ()
        found[k, : len(law.coef)] = law.coef
    return found


SHAPE = 2.5
"""Largest magnitude of the numbers of `polynomial`."""

USUAL_SHAPE = (0.0, 0.16, 0.0, 0.17, 0.0, -0.04, 0.0, 0.1)
"""Those with which its velocity is about that of a modified trapezoid."""

SLOWEST, PLACES = 0.03, np.linspace(-1.0, 1.0, 41)
"""Smallest value of that shape, for a motion that doesn't stop on its way, and places where it is examined."""

NARROWEST = 0.3
"""Smallest width of a corner, as a fraction of its height."""

FREQUENCIES = 0.8, 1.3
"""Range of the frequencies that shapers are designed for, as multiples of those at the end pose: along the path they differ."""

LEAST_TIME = 0.05
"""Smallest part of the total time that a motion without shapers takes."""

INTERVALS, LONGEST = 48, 0.01
"""Least number of parts of a motion, and longest one [s]."""

DIFFERENCE = 1e-3
"""Change of a number, and relative one of the duration, for derivatives."""

PATHS = ((0.7, 0.8, 0.5), (1.0, 1.0, 0.1), (0.2, 0.8, 0.5))
"""Lift, height and width of the corners to begin with, as points of the unit cube: usual ones, and what goes around walls."""


@dataclass(frozen=True)
class MotionFamily:
    """Motions whose corners and shapers have the same kinds.

    Their numbers (n,) are a point of the unit cube: lift, height and width of the corners, shape of the time law, frequencies of the
    shapers.

    Attributes:
        scene: whose path it is.
        heights: smallest and largest height of the path [m].
        blend: kind of the corners.
        shapers: kind of each, and its mode at the end of the motion.
    """

    scene: Scene
    heights: tuple[float, float]
    blend: str
    shapers: tuple[ShaperChoice, ...] = ()

    def start(self, path: tuple[float, ...]) -> RealArray:
        """Numbers to begin with: lift and corners, a smooth time law, and frequencies above the modes' own."""
        low, high = FREQUENCIES
        law = [0.5 + 0.5 * each / SHAPE for each in USUAL_SHAPE]
        return np.array([*path, *law, *[(1.05 - low) / (high - low)] * len(self.shapers)])

    @property
    def are_free(self) -> NDArray[np.bool_]:
        """Which numbers any value does for (n,): not those of the time law, see `FamilyMotion.conditions`."""
        first, last = len(PATHS[0]), len(PATHS[0]) + len(USUAL_SHAPE)
        index = np.arange(last + len(self.shapers))
        return (index < first) | (index >= last)

    def path(self, numbers: RealArray) -> RealArray:
        """Points of the path of these numbers (N, 2) [m].

        Raises:
            TrajectoryError: it isn't feasible.
        """
        section = self.scene.trajectory
        assert isinstance(section, TrajectorySection)
        design = replace(self, shapers=()).design(numbers[: -len(self.shapers) or None], 1.0)
        corner = BLENDS[self.blend].make(*design.corner)
        path = PickAndPlacePath(section.start, section.lift, design.height, section.width, corner)
        x, y = path.jets(np.linspace(0.0, path.length, NODES), 0)
        return np.stack([x.value, y.value], axis=-1)

    def design(self, numbers: RealArray, total: float) -> Design:
        """The motion of these numbers with a duration [s].

        Raises:
            TrajectoryError: the shapers take longer than the motion, or there are none for a mode's damping.
        """
        section = self.scene.trajectory
        assert isinstance(section, TrajectorySection)
        lift, tall, wide, *others = np.asarray(numbers).tolist()
        shape, frequencies = others[: len(USUAL_SHAPE)], others[len(USUAL_SHAPE) :]
        height = _along(self.heights, lift)
        tall = height * (0.3 + 0.7 * tall)
        high = 0.5 * section.width
        low = min(NARROWEST * tall, high)
        width = exp(_along((log(low), log(high)), wide))
        law = polynomial([_along((-SHAPE, SHAPE), each) for each in shape])
        pairs = zip(self.shapers, frequencies, strict=True)
        shapers = tuple(
            (kind, replace(mode, frequency=mode.frequency * _along(FREQUENCIES, number)))
            for (kind, mode), number in pairs
        )
        duration = total - sum(_sequence(each).duration for each in shapers)
        if duration < LEAST_TIME * total:
            raise TrajectoryError("shapers take longer than the motion")
        return Design(self.blend, (tall, width), height, law, shapers, duration)


def _along(ends: tuple[float, float], fraction: float) -> float:
    """A number from one end to the other."""
    return ends[0] + (ends[1] - ends[0]) * fraction


@dataclass(frozen=True, eq=False)
class FamilyMotion:
    """A motion of a family; its variables as a `flexfmu.model.reference_design.joint_spline.DesignedMotion` are its numbers and T.

    Attributes:
        family: the family.
        numbers: its numbers (n,).
        duration: T with shapers [s].
        usual: a usual duration [s], by which steps are chosen.
    """

    family: MotionFamily
    numbers: RealArray
    duration: float
    usual: float
    _known: dict[tuple[bytes, str], RealArray] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def design(self) -> Design:
        """The motion itself.

        Raises:
            TrajectoryError: see `MotionFamily.design`.
        """
        return self.family.design(self.numbers, self.duration)

    @property
    def intervals(self) -> int:
        """Number of equal parts of the duration."""
        return max(INTERVALS, round(self.usual / LONGEST))

    @property
    def room(self) -> tuple[RealArray, RealArray]:
        """Largest changes of the variables: numbers stay in the unit cube."""
        return np.append(-self.numbers, -np.inf), np.append(1.0 - self.numbers, np.inf)

    def with_duration(self, duration: float) -> FamilyMotion:
        """Return the motion with another duration."""
        return replace(self, duration=duration)

    def moved(self, change: RealArray) -> FamilyMotion:
        """Return the motion after a change of its variables (n + 1,)."""
        numbers = np.clip(self.numbers + change[:-1], 0.0, 1.0)
        return replace(self, numbers=numbers, duration=self.duration + float(change[-1]))

    def evaluate(self, fraction: ArrayLike, order: int = 2) -> RealArray:
        """Return joint angles with up to two derivatives (order + 1, N, 2) at fractions of the duration.

        Raises:
            TrajectoryError: the path or a shaper is not feasible.
        """
        points = np.atleast_1d(np.asarray(fraction, dtype=float))
        key = points.tobytes(), "values"
        if key not in self._known:
            self._known[key] = references(self.family.scene, self.design, points * self.duration)
        return self._known[key][: order + 1]

    def derivatives(self, fractions: RealArray) -> RealArray:
        """Return derivatives (N, 6, n + 1) of [q_a, v_a, a_a] by the variables; zero by those that can't change."""
        key = fractions.tobytes(), "derivatives"
        if key not in self._known:
            here, found = self.evaluate(fractions), np.zeros((len(fractions), 6, len(self.numbers) + 1))
            # towards the middle of the cube
            steps = np.append(np.where(self.numbers > 0.5, -DIFFERENCE, DIFFERENCE), DIFFERENCE * self.duration)
            for k, step in enumerate(steps.tolist()):
                change = np.zeros(len(steps))
                change[k] = step
                try:
                    found[..., k] = np.hstack(list((self.moved(change).evaluate(fractions) - here) / step))
                except TrajectoryError:
                    continue
            self._known[key] = found
        return self._known[key]

    def rates(self, fractions: RealArray) -> list[RealArray]:
        """Return speeds, accelerations and mean jerks between the fractions (n, 2)."""
        _, speed, acceleration = self.evaluate(fractions)
        return [speed, acceleration, np.diff(acceleration, axis=0) / (self.duration * np.diff(fractions)[:, None])]

    def rates_by(self, fractions: RealArray) -> list[RealArray]:
        """Return their derivatives (n, 2, n + 1)."""
        _, speed, acceleration = self.derivatives(fractions).reshape(len(fractions), 3, 2, -1).swapaxes(0, 1)
        jerk = np.diff(acceleration, axis=0) / (self.duration * np.diff(fractions)[:, None, None])
        jerk[..., -1] -= self.rates(fractions)[2] / self.duration
        return [speed, acceleration, jerk]

    def conditions(self) -> tuple[RealArray, RealArray]:
        """Return by how much the time law's shape is below the smallest allowed, and the slopes by the variables."""
        waves = np.polynomial.legendre.legvander(PLACES, len(USUAL_SHAPE))[:, 1:]
        slopes = np.zeros((len(PLACES), len(self.numbers) + 1))
        slopes[:, 3 : 3 + len(USUAL_SHAPE)] = -2.0 * SHAPE * waves
        return SLOWEST - 1.0 + slopes[:, :-1] @ (self.numbers - 0.5), slopes

    def scale(self, unit: float) -> RealArray:
        """Return the size of changes that count alike: the cube's, and a usual duration [s]."""
        return np.append(np.ones(len(self.numbers)), unit)

    def metric(self, unit: float) -> RealArray:
        """Return the squared size (n + 1, n + 1) of changes of the acceleration, relative to the largest one, and of the duration."""
        fractions = np.linspace(0.0, 1.0, INTERVALS + 1)
        by = (
            self.derivatives(fractions)[:, 4:].reshape(-1, len(self.numbers) + 1)
            / np.abs(self.evaluate(fractions)[2]).max()
        )
        by[:, -1] = 0.0
        found = by.T @ by
        found[-1, -1] = 0.1 * INTERVALS / unit**2
        return np.asarray(found)
