"""What a search may choose of a motion: corners, lift, time law and shapers, and the joint references that follow.

A path is tabulated once by its arc length, with the joint angles and two derivatives; every time law, duration and shaper on it
then costs a millisecond. Motions whose corners and shapers have the same kinds are a family, whose numbers are points of a unit cube. With
the duration they are the variables of a motion that optimal control improves: the derivatives of references are differences.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, reduce
from math import fsum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.path import BLENDS, PickAndPlacePath
from flexfmu.trajectories.piecewise import PiecewisePolynomial, spline
from flexfmu.trajectories.profiles import PROFILES, Profile, evaluate_profile
from flexfmu.trajectories.shapers.designs import design as design_shaper
from flexfmu.trajectories.shapers.sequence import UNSHAPED, ImpulseSequence, Oscillator

NODES = 400
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


@lru_cache(maxsize=1024)
def _sequence(choice: ShaperChoice) -> ImpulseSequence:
    """The impulses of a shaper.

    Raises:
        TrajectoryError: there is no such shaper for this damping.
    """
    return design_shaper(choice[0], [choice[1]])


@lru_cache(maxsize=256)
def _profile(law: tuple[float, ...]) -> Profile:
    return PROFILES["polynomial"].make(coefficients=law)


@lru_cache(maxsize=256)
def polynomial(shape: tuple[float, ...]) -> tuple[float, ...]:
    """Coefficients of a time law with the velocity c (η(1 - η))² (1 + Σ shape_k P_k(2η - 1)), with Legendre polynomials from k = 1.

    It is at rest with zero acceleration at both ends; without a shape it is the polynomial of fifth degree.
    """
    waves = np.polynomial.Legendre([1.0, *shape], domain=[0.0, 1.0]).convert(kind=np.polynomial.Polynomial)
    law: RealArray = np.array((waves * np.polynomial.Polynomial([0.0, 0.0, 1.0, -2.0, 1.0])).integ().coef)
    law /= law.sum()
    # large coefficients of both signs leave rounding errors of the end, which small ones take back
    place, slope = fsum(law) - 1.0, fsum(law * np.arange(len(law)))
    law[2:4] += [slope - 3.0 * place, 2.0 * place - slope]
    return tuple(law.tolist())


@lru_cache(maxsize=16)
def path_table(mechanism: Mechanism, path: PickAndPlacePath) -> PiecewisePolynomial:
    """Joint angles [rad] by the arc length [m] of a path.

    Raises:
        TrajectoryError: the path leaves the workspace.
    """
    nodes = np.union1d(np.linspace(0.0, path.length, NODES), path.knots)
    x, y = path.jets(nodes, 2)
    kinematics = RigidKinematics(mechanism)
    # within the workspace, away from singularities
    for margin in kinematics.margins(np.stack([x.value, y.value], axis=-1)):
        if not (margin.values >= margin.required).all():
            raise TrajectoryError(f"{margin.name} is too small along the path")
    values = np.stack([joint.derivatives() for joint in kinematics.joints(x, y)], axis=-1)
    values[0] = np.unwrap(values[0], axis=0)
    return spline(nodes, values, coordinates="joints")


def first_numbers(path: tuple[float, float, float], shapers: int) -> RealArray:
    """Numbers of a motion to begin with: those of its path, a smooth time law, and frequencies above the modes' own."""
    low, high = FREQUENCIES
    law = [0.5 + 0.5 * each / SHAPE for each in USUAL_SHAPE]
    return np.array([*path, *law, *[(USUAL_FREQUENCY - low) / (high - low)] * shapers])


def _along(ends: tuple[float, float], fraction: float) -> float:
    """A number from one end to the other."""
    return ends[0] + (ends[1] - ends[0]) * fraction


@dataclass(frozen=True, eq=False)
class FamilyMotion:
    """A motion of a family; its variables as a `flexfmu.model.reference_design.joint_spline.DesignedMotion` are its numbers and T.

    Attributes:
        mechanism, section: of the scene whose pick and place it goes between.
        heights: smallest and largest height of the path [m].
        blend: kind of the corners.
        shapers: kind of each, and its mode at the end of the motion.
        numbers: a point of the unit cube (n,): lift, height and width of the corners, shape of the time law, frequencies of the shapers.
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
    _known: dict[tuple[bytes, str], RealArray] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def path(self) -> PickAndPlacePath:
        """The path.

        Raises:
            TrajectoryError: it isn't feasible.
        """
        lift, tall, wide = self.numbers[: LAW.start].tolist()
        height = _along(self.heights, lift)
        tall, widest = height * _along((LEAST_TALL, 1.0), tall), 0.5 * self.section.width
        narrowest = min(NARROWEST * tall, widest)
        corner = BLENDS[self.blend].make(tall, narrowest * (widest / narrowest) ** wide)
        return PickAndPlacePath(self.section.start, self.section.lift, height, self.section.width, corner)

    @property
    def points(self) -> RealArray:
        """Points of the path (N, 2) [m]; errors as of `path`."""
        x, y = self.path.jets(np.linspace(0.0, self.path.length, NODES), 0)
        return np.stack([x.value, y.value], axis=-1)

    @property
    def law(self) -> tuple[float, ...]:
        """Coefficients of the time law, a polynomial."""
        return polynomial(tuple((SHAPE * (2.0 * self.numbers[LAW] - 1.0)).tolist()))

    @cached_property
    def chosen(self) -> tuple[ShaperChoice, ...]:
        """The shapers with the frequencies that they are designed for."""
        multiples = (_along(FREQUENCIES, number) for number in self.numbers[LAW.stop :].tolist())
        pairs = zip(self.shapers, multiples, strict=True)
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
            TrajectoryError: the path or a shaper is not feasible, or the shapers take longer than the motion.
        """
        points = np.atleast_1d(np.asarray(fraction, dtype=float))
        key = points.tobytes(), "values"
        if key not in self._known:
            table, duration, impulses = path_table(self.mechanism, self.path), self.unshaped_duration, self.sequence
            # arc length and its derivatives, delayed by each impulse; time laws are at rest at both ends
            eta = np.clip((points * self.duration - np.array(impulses.times)[:, None]) / duration, 0.0, 1.0)
            fractions = evaluate_profile(_profile(self.law), eta.ravel(), 2).derivatives()
            s, speed, change = fractions * table.duration / duration ** np.arange(3)[:, None]
            # joint angles by the chain rule, then the shapers' sum
            angle, slope, bend = table.evaluate(np.clip(s, 0.0, table.duration), 2)
            speed, change = speed[:, None], change[:, None]
            joints = np.stack([angle, slope * speed, bend * speed**2 + slope * change]).reshape(3, -1, points.size, 2)
            self._known[key] = np.asarray(np.einsum("j,kjni->kni", np.array(impulses.amplitudes), joints))
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
                with suppress(TrajectoryError):
                    found[..., k] = np.hstack(list((self.moved(change).evaluate(fractions) - here) / step))
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
        slopes[:, LAW] = -2.0 * SHAPE * waves
        return SLOWEST - 1.0 + slopes[:, :-1] @ (self.numbers - 0.5), slopes

    def scale(self, unit: float) -> RealArray:
        """Return the size of changes that count alike: the cube's, and a usual duration [s]."""
        return np.append(np.ones(len(self.numbers)), unit)

    def metric(self, unit: float) -> RealArray:
        """Return the squared size (n + 1, n + 1) of changes of the acceleration, relative to the largest one, and of the duration."""
        fractions = np.linspace(0.0, 1.0, INTERVALS + 1)
        by = self.derivatives(fractions)[:, 4:, :-1].reshape(-1, len(self.numbers))
        by /= np.abs(self.evaluate(fractions)[2]).max()
        return block_diag(by.T @ by, [0.1 * INTERVALS / unit**2])
