"""What a search may choose of a motion: corners, lift, time law and shapers, and the joint references that follow.

A path is tabulated once by its arc length, with the joint angles and two derivatives; every time law, duration and shaper on it
then costs a millisecond.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Any

import numpy as np

from flexfmu.cosim.design.plans.quick_runs import JointMotion
from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.blends import BLENDS
from flexfmu.trajectories.curves import Point
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.path import PickAndPlacePath
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
    mechanism: Mechanism,
    start: Point,
    lift: Point,
    width: float,
    height: float,
    corner: tuple[str, float, float],
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
