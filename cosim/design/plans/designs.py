"""What a search may choose of a motion: corners, lift, time law and shapers, and the joint references that follow.

A path is tabulated once by its arc length, with the joint angles and two derivatives; every time law, duration and shaper on it
then costs a millisecond. Kinds of corners, time laws and shapers are a motion family, whose numbers are points of a unit cube.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce
from itertools import product
from math import exp, log
from typing import Any

import numpy as np

from flexfmu.cosim.design.plans.quick_runs import JointMotion
from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.curves import Point
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.path import BLENDS, HIGHEST_RATIO, LOWEST_RATIO, PickAndPlacePath
from flexfmu.trajectories.piecewise import PiecewisePolynomial, spline
from flexfmu.trajectories.profiles import PROFILES, evaluate_profile
from flexfmu.trajectories.shapers.designs import design as design_shaper
from flexfmu.trajectories.shapers.designs import specified_insensitivity
from flexfmu.trajectories.shapers.sequence import UNSHAPED, ImpulseSequence, Oscillator

NODES = 400
"""Nodes of a tabulated path; quintics between them are exact to 1e-9 rad."""

Values = tuple[tuple[str, float | tuple[float, ...]], ...]
"""Names and values of a profile's parameters."""


@dataclass(frozen=True)
class ShaperChoice:
    """A shaper.

    Attributes:
        kind: key of `flexfmu.trajectories.shapers.designs.SHAPERS`, or ``si``.
        frequencies: of the mode [Hz]; of ``si`` the lowest and the highest of its band.
        ratio: damping ratio.
        apply: ``joints`` or ``path``.
        tolerance: of ``si``, see `specified_insensitivity`.
    """

    kind: str
    frequencies: tuple[float, ...]
    ratio: float
    apply: str
    tolerance: float = 0.05

    @property
    def section(self) -> dict[str, Any]:
        """The keys of the scene file's `[[shaper]]` table."""
        if self.kind == "si":
            band = list(self.frequencies)
            return {"kind": "si", "band": band, "ratio": self.ratio, "tolerance": self.tolerance, "apply": self.apply}
        modes = [{"frequency": each, "ratio": self.ratio} for each in self.frequencies]
        return {"kind": self.kind, "modes": modes, "apply": self.apply}

    @property
    def sequence(self) -> ImpulseSequence:
        """The impulses.

        Raises:
            TrajectoryError: there is no such shaper for this damping or band.
        """
        return _sequence(self.kind, self.frequencies, self.ratio, self.tolerance)


@lru_cache(maxsize=1024)
def _sequence(kind: str, frequencies: tuple[float, ...], ratio: float, tolerance: float) -> ImpulseSequence:
    if kind == "si":
        return specified_insensitivity(frequencies[0], frequencies[1], tolerance, ratio)
    return design_shaper(kind, [Oscillator(each, ratio) for each in frequencies])


@dataclass(frozen=True)
class Design:
    """A motion between the pick and the place of a scene.

    Attributes:
        blend: kind of the corners.
        corner: their height and width [m].
        height: of the lift [m].
        profile: kind of the time law.
        parameters: of the time law.
        shapers: all shapers.
        duration: without shapers [s].
    """

    blend: str
    corner: tuple[float, float]
    height: float
    profile: str
    parameters: Values
    shapers: tuple[ShaperChoice, ...]
    duration: float

    def sequence(self, place: str) -> ImpulseSequence:
        """All impulses on ``joints`` or on ``path``."""
        chosen = [each.sequence for each in self.shapers if each.apply == place]
        return reduce(ImpulseSequence.convolve, chosen) if chosen else UNSHAPED

    @property
    def total(self) -> float:
        """Duration with shapers [s]."""
        return self.duration + sum(each.sequence.duration for each in self.shapers)

    @property
    def changes(self) -> dict[str, Any]:
        """Keys of the scene with their values."""
        height, width = self.corner
        return {
            "trajectory.height": self.height,
            "trajectory.blend": {"kind": self.blend, "height": height, "width": width},
            "trajectory.profile": {"kind": self.profile, **{name: _plain(each) for name, each in self.parameters}},
            "trajectory.duration": self.duration,
            "shaper": [each.section for each in self.shapers],
        }

    @property
    def label(self) -> str:
        """Corners, time law and shapers in a line."""
        height, width = self.corner
        shapers = " x ".join(f"{each.kind} on {each.apply}" for each in self.shapers) or "unshaped"
        return f"{self.blend} {1e3 * width:.0f} x {1e3 * height:.0f} mm, {self.profile}, {shapers}"


def _plain(value: float | tuple[float, ...]) -> float | list[float]:
    return list(value) if isinstance(value, tuple) else value


def references(scene: Scene, design: Design, steps: int) -> JointMotion:
    """Joint references of a design at the ends of so many equal steps.

    Raises:
        TrajectoryError: the path or a shaper is not feasible.
    """
    section = scene.trajectory
    assert isinstance(section, TrajectorySection)
    corner = design.blend, *design.corner
    table = path_table(scene.mechanism, section.start, section.lift, section.width, design.height, corner)
    on_path, on_joints = design.sequence("path"), design.sequence("joints")
    total = design.duration + on_path.duration + on_joints.duration
    time = np.linspace(0.0, total, steps + 1)
    # arc length and its derivatives, delayed by all impulses; profiles are at rest at both ends
    delays = np.add.outer(on_joints.times, on_path.times)
    eta = np.clip((time - delays[:, :, None]) / design.duration, 0.0, 1.0)
    profile = _profile(design.profile, design.parameters)
    fractions = evaluate_profile(profile, eta.ravel(), 2).derivatives().reshape(3, *eta.shape)
    fractions = np.einsum("p,kjpn->kjn", np.array(on_path.amplitudes), fractions)
    length = table.duration
    s, speed, change = (fractions * length / design.duration ** np.arange(3)[:, None, None]).reshape(3, -1)
    # joint angles by the chain rule, then the shaper's sum
    angle, slope, bend = table.evaluate(np.clip(s, 0.0, length), 2)
    speed, change = speed[:, None], change[:, None]
    joints = np.stack([angle, slope * speed, bend * speed**2 + slope * change])
    shaped = np.einsum("j,kjni->kni", np.array(on_joints.amplitudes), joints.reshape(3, -1, time.size, 2))
    return JointMotion(time, shaped)


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
def _profile(kind: str, parameters: Values) -> Any:
    return PROFILES[kind].make(**dict(parameters))


def polynomial(shape: Sequence[float]) -> Values:
    """Parameters of a time law with the velocity c (η(1 - η))² (1 + Σ shape_k P_k(2η - 1)), with Legendre polynomials from k = 1.

    It is at rest with zero acceleration at both ends; without a shape it is the polynomial of fifth degree.
    """
    law = np.array([1.0, *shape]) @ _laws(len(shape))
    return (("coefficients", tuple((law / law.sum()).tolist())),)


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


LAWS = {"polynomial": 8, "double-s": 2, "modified-trapezoid": 0}
"""Time laws → number of their parameters. Their accelerations don't jump; the others lie between them."""

SHAPE = 2.5
"""Largest magnitude of the numbers of `flexfmu.cosim.design.plans.designs.polynomial`."""

USUAL_SHAPE = (0.0, 0.16, 0.0, 0.17, 0.0, -0.04, 0.0, 0.1)
"""Those with which its velocity is about that of the modified trapezoid."""

SLOWEST, PLACES = 0.03, np.linspace(-1.0, 1.0, 41)
"""Smallest value of that shape, for a motion that doesn't stop on its way, and places where it is examined."""

CORNERS = ("lame", "polar", "clothoid")
"""Kinds of corners."""

NARROWEST = 0.3
"""Smallest width of a corner, as a fraction of its height."""

SHORTEST, LONGEST = 0.3, 2.5
"""Range of total times, as multiples of the given one."""

FREQUENCIES = 0.8, 1.3
"""Range of the frequencies that shapers are designed for, as multiples of those at the end pose: along the path they differ."""

LEAST_TIME = 0.05
"""Smallest part of the total time that a motion without shapers takes."""

SINGLE = ("zv", "zvd", "ei", "zvdd", "2-hump-ei")
"""Shapers for one mode."""

PAIRS = (("zv", "zv"), ("zvd", "zv"), ("zv", "zvd"), ("zvd", "zvd"), ("ei", "ei"), ("zvdd", "zvd"))
"""Shapers for the two lowest modes."""

BAND_ENDS, LEVELS = (0.75, 1.25), (0.005, 0.1)
"""Range of the ends of a specified-insensitivity shaper's band, as multiples of the lowest and the highest mode, and of its tolerance."""

Use = tuple[str, int, str]
"""Kind of a shaper, number of its mode (of ``si`` that of the highest one), and where it is applied."""


@dataclass(frozen=True)
class MotionFamily:
    """Kinds of what a motion consists of.

    Attributes:
        blend: kind of the corners.
        law: kind of the time law.
        shapers: all shapers.
    """

    blend: str
    law: str
    shapers: tuple[Use, ...]


def shaper_uses(modes: int) -> list[tuple[Use, ...]]:
    """All combinations of shapers for a robot with so many modes."""
    found: list[tuple[Use, ...]] = [()]
    if modes:
        found += [(("si", k, place),) for k in range(min(modes, 2)) for place in ("joints", "path")]
        found += [((kind, 0, place),) for kind in SINGLE for place in ("joints", "path")]
    if modes > 1:
        found += [((a, 0, "joints"), (b, 1, "joints")) for a, b in PAIRS]
        found += [(("zvd", 0, "path"), ("zvd", 1, "path")), (("zvd", 0, "joints"), ("zvd", 1, "path"))]
    return found


@dataclass(frozen=True)
class Space:
    """What a search may choose from.

    Attributes:
        modes: of vibration at the end of the motion, lowest first.
        lift: smallest and largest height of the path [m].
        width: of the crossing [m].
        usual: total time of the given motion [s].
        total: total time of all motions [s]; None where it is free.
    """

    modes: tuple[Oscillator, ...]
    lift: tuple[float, float]
    width: float
    usual: float
    total: float | None = None

    def size(self, family: MotionFamily) -> int:
        """Number of numbers of a family: time, lift, height and width of the corners, time law, frequencies."""
        return 4 + LAWS[family.law] + sum(3 if kind == "si" else 1 for kind, _, _ in family.shapers)

    def start(self, family: MotionFamily) -> RealArray:
        """A point (n,) of the unit cube to begin with: high corners, a smooth time law and the modes' own frequencies."""
        low, high = FREQUENCIES
        law = {"polynomial": [0.5 + 0.5 * each / SHAPE for each in USUAL_SHAPE], "double-s": [0.8, 0.6]}.get(
            family.law, []
        )
        own = [(1.05 - low) / (high - low)]
        shapers = [number for kind, _, _ in family.shapers for number in ([0.4, 0.6, 0.4] if kind == "si" else own)]
        return np.array([0.5, 0.7, 0.8, 0.5, *law, *shapers])

    def with_total(self, point: RealArray, total: float) -> RealArray:
        """The point with another total time [s], within the range."""
        fraction = (log(total / self.usual) - log(SHORTEST)) / (log(LONGEST) - log(SHORTEST))
        return np.array([min(max(fraction, 0.0), 1.0), *point[1:]])

    def design(self, family: MotionFamily, point: RealArray) -> Design:
        """The motion of a point of the unit cube.

        Raises:
            TrajectoryError: the shapers take longer than the motion may, or there are none for a mode's damping.
        """
        numbers = iter(np.asarray(point).tolist())
        time, lift, tall, wide = (next(numbers) for _ in range(4))
        total = self.usual * _between((SHORTEST, LONGEST), time) if self.total is None else self.total
        # corners
        height = self.lift[0] + (self.lift[1] - self.lift[0]) * lift
        tall = height * (0.3 + 0.7 * tall)
        low, high = NARROWEST * tall, 0.5 * self.width
        if family.blend == "clothoid":
            low, high = 1.01 * LOWEST_RATIO * tall, min(high, 0.99 * HIGHEST_RATIO * tall)
        width = _between((min(low, high), high), wide)
        # parameters of the time law
        values: Values = ()
        own = [next(numbers) for _ in range(LAWS[family.law])]
        if family.law == "polynomial":
            values = polynomial([_along((-SHAPE, SHAPE), each) for each in own])
        elif family.law == "double-s":
            ramp = 0.2 + 0.3 * own[0]
            values = (("ramp", ramp), ("jerk_phase", ramp * (0.05 + 0.45 * own[1])))
        # shapers
        shapers = list[ShaperChoice]()
        for kind, mode, place in family.shapers:
            first, last = self.modes[0], self.modes[mode]
            if kind == "si":
                ends = [each.frequency * _along(BAND_ENDS, next(numbers)) for each in (first, last)]
                level = _between(LEVELS, next(numbers))
                shapers.append(ShaperChoice(kind, (min(ends), max(ends)), first.ratio, place, level))
            else:
                frequency = last.frequency * _along(FREQUENCIES, next(numbers))
                shapers.append(ShaperChoice(kind, (frequency,), last.ratio, place))
        duration = total - sum(each.sequence.duration for each in shapers)
        if duration < LEAST_TIME * total:
            raise TrajectoryError("shapers take longer than the motion")
        return Design(family.blend, (tall, width), height, family.law, values, tuple(shapers), duration)

    def forward(self, family: MotionFamily, point: RealArray) -> tuple[RealArray, RealArray]:
        """By how much a polynomial's shape is above the smallest allowed (M,), and the slopes by the numbers (M, n)."""
        count = LAWS[family.law] if family.law == "polynomial" else 0
        waves = np.polynomial.legendre.legvander(PLACES, count)[:, 1:]
        slopes = np.zeros((len(PLACES), len(point)))
        slopes[:, 4 : 4 + count] = 2.0 * SHAPE * waves
        return 1.0 + slopes @ (np.asarray(point) - 0.5) - SLOWEST, slopes


def _along(ends: tuple[float, float], fraction: float) -> float:
    """A number from one end to the other."""
    return ends[0] + (ends[1] - ends[0]) * fraction


def _between(ends: tuple[float, float], fraction: float) -> float:
    """A number from one end to the other in equal ratios."""
    return exp(log(ends[0]) + (log(ends[1]) - log(ends[0])) * fraction)


def motion_families(shapers: Iterable[tuple[Use, ...]], laws: Iterable[str] = tuple(LAWS)) -> list[MotionFamily]:
    """Each of these time laws on every kind of corner with each of these combinations of shapers."""
    return [MotionFamily(blend, law, uses) for uses, blend, law in product(shapers, CORNERS, laws)]
