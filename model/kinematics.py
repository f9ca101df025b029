"""The rigid five-bar: inverse and forward kinematics of points and jets, margins to singularities, and mass matrix, without CasADi.

Base, elbow and end effector of a leg form a triangle with known sides: the law of cosines gives the motor angle, with
the sign of the working mode (type-1 singularities where a leg is stretched or folded). The end effector is an
intersection of two circles about the elbows, chosen by the assembly mode (type-2 singularities where the distal links
are parallel; Gosselin and Angeles, Singularity analysis of closed-loop kinematic chains, IEEE Trans. Robot. Autom. 6
(1990)).

A uniform rod of mass m with end velocities v_a and v_b has the kinetic energy m/6 (v_a² + v_a · v_b + v_b²). The end
effector's velocity follows from the constant lengths of the distal links: (X - E_i) · (X' - E_i') = 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flexfmu.model.scene.assembly import WORKING_MODES, bases
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import Jet, RealArray, arctan2, sincos, sqrt, stack, unstack
from flexfmu.trajectories.joint import Margin

REACH_MARGIN = 1e-3
"""Smallest margin [m] to a stretched or folded leg (type-1 singularity) that planning accepts: joint rates grow like
1/sqrt(margin)."""

SINE_MARGIN = 0.02
"""Smallest sine of the angle between the distal links (type-2 singularity) that planning accepts: at 0.026 (elbows
10 mm apart on the paper's robot) the first natural frequency has fallen from 80 Hz to 3 Hz."""

SINE_NAME = "sine of the angle between the distal links (type-2 singularity)"


@dataclass(frozen=True)
class RigidKinematics:
    """Inverse kinematics in the working mode, and forward kinematics in the assembly mode; implements `InverseKinematics` and
    `ForwardKinematics` of `flexfmu.trajectories.joint`."""

    mechanism: Mechanism

    def joints(self, x: Jet, y: Jet) -> tuple[Jet, Jet]:
        """Jets of q11 and q21 [rad] from jets of the end-effector position [m]."""
        # both legs at once, along a leading axis
        proximal, distal = self.mechanism.proximal.length, self.mechanism.distal.length
        legs = (2, *(1,) * len(x.shape))
        signs = np.array(WORKING_MODES[self.mechanism.working_mode], dtype=float).reshape(legs)
        base_x, base_y = (
            np.array(base, dtype=float).reshape(legs) for base in zip(*bases(self.mechanism), strict=True)
        )
        dx, dy = x - base_x, y - base_y
        square = dx * dx + dy * dy
        # elbow angle from cosine and sine, both times 2 l r: acos would be inaccurate near ±1
        cosine = square + (proximal**2 - distal**2)
        sine = sqrt(4.0 * proximal**2 * square - cosine * cosine)
        arm, elbow = unstack(arctan2(stack((dy, sine)), stack((dx, cosine))))
        return unstack(arm + signs * elbow)

    def margins(self, position: RealArray) -> tuple[Margin, ...]:
        """Distances to the workspace boundary and to the type-2 singularity at positions (N, 2) [m].

        The sine is NaN out of reach.
        """
        # type 1: margin of each leg to being stretched or folded
        proximal, distal = self.mechanism.proximal.length, self.mechanism.distal.length
        distances = [np.hypot(*(position - base).T) for base in bases(self.mechanism)]
        reaches = [
            Margin(
                f"reach of leg {leg}", "m", np.minimum(proximal + distal - d, d - abs(proximal - distal)), REACH_MARGIN
            )
            for leg, d in enumerate(distances, 1)
        ]
        # type 2: angle between the distal links
        return (*reaches, Margin(SINE_NAME, "1", self.sine(position), SINE_MARGIN))

    def sine(self, position: RealArray) -> RealArray:
        """Sine of the angle between the distal links at positions (N, 2) [m], shape (N,).

        It is negative in the other assembly mode, and NaN out of reach.
        """
        elbow1, elbow2 = self.elbows(position)
        line, arm = elbow2 - elbow1, position - elbow1
        side = 1.0 if self.mechanism.assembly_mode == "left" else -1.0
        return np.asarray(side * (line[:, 0] * arm[:, 1] - line[:, 1] * arm[:, 0]) / self.mechanism.distal.length**2)

    def elbows(self, position: RealArray) -> list[RealArray]:
        """Elbow points (N, 2) [m] of both legs, NaN out of reach."""
        proximal, distal = self.mechanism.proximal.length, self.mechanism.distal.length
        elbows = []
        for base, sign in zip(bases(self.mechanism), WORKING_MODES[self.mechanism.working_mode], strict=True):
            arm = position - base
            # angle between arm and proximal link, by the law of cosines
            square = np.sum(arm**2, axis=1)
            cosine = square + (proximal**2 - distal**2)
            # out of reach the square root is NaN
            with np.errstate(invalid="ignore"):
                sine = np.sqrt(4.0 * proximal**2 * square - cosine**2)
            angle = np.arctan2(arm[:, 1], arm[:, 0]) + sign * np.arctan2(sine, cosine)
            elbows.append(np.asarray(base) + proximal * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
        return elbows

    def end_effector(self, q11: Jet, q21: Jet) -> tuple[Jet, Jet]:
        """Jets of the end effector's x and y [m] from jets of the joint angles [rad].

        Both distal links have the same length: the end effector lies on the perpendicular bisector of the elbows.
        """
        (x1, y1), (x2, y2) = self._elbow(0, q11), self._elbow(1, q21)
        dx, dy = x2 - x1, y2 - y1
        square = dx * dx + dy * dy
        side = 1.0 if self.mechanism.assembly_mode == "left" else -1.0
        height = side * sqrt(self.mechanism.distal.length**2 / square - 0.25)
        return 0.5 * (x1 + x2) - height * dy, 0.5 * (y1 + y2) + height * dx

    def _elbow(self, leg: int, angle: Jet) -> tuple[Jet, Jet]:
        sine, cosine = sincos(angle)
        (base_x, base_y), length = bases(self.mechanism)[leg], self.mechanism.proximal.length
        return length * cosine + base_x, length * sine + base_y


def load_mass_matrix(scene: Scene, joints: RealArray) -> RealArray:
    """Return the mass matrix (N, 2, 2) [kg.m2] of links and payload at motor angles (N, 2) [rad], without the motors.

    Links are slender: the rotary inertia of their cross sections is left out.
    """
    mechanism, count = scene.mechanism, len(joints)
    length = mechanism.proximal.length
    masses = [
        mechanism.material.density * math.pi / 4.0 * (link.diameter**2 - link.inner_diameter**2) * link.length
        for link in (mechanism.proximal, mechanism.distal)
    ]
    # elbows, the end effector beside the middle between them, and velocities for unit rates
    cosine, sine = np.cos(joints), np.sin(joints)
    elbows = np.array(bases(mechanism)) + length * np.stack([cosine, sine], axis=-1)
    line = elbows[:, 1] - elbows[:, 0]
    side = 1.0 if mechanism.assembly_mode == "left" else -1.0
    height = side * np.sqrt(mechanism.distal.length**2 / np.sum(line**2, axis=1) - 0.25)
    end = elbows.mean(axis=1) + height[:, np.newaxis] * np.stack([-line[:, 1], line[:, 0]], axis=-1)
    arms, turning = end[:, np.newaxis] - elbows, length * np.stack([-sine, cosine], axis=-1)
    drive = np.zeros((count, 2, 2))
    for leg in (0, 1):
        drive[:, leg, leg] = np.einsum("nk,nk->n", arms[:, leg], turning[:, leg])
    effector: RealArray = np.asarray(np.linalg.solve(arms, drive), dtype=float)
    # proximal links turn about their bases, then distal links and payload
    matrix: RealArray = np.tile(masses[0] * length**2 / 3.0 * np.eye(2), (count, 1, 1))
    for leg in (0, 1):
        elbow = np.zeros((count, 2, 2))
        elbow[:, :, leg] = turning[:, leg]
        mixed = _gram(elbow, effector)
        matrix += (
            masses[1] / 3.0 * (_gram(elbow, elbow) + 0.5 * (mixed + mixed.swapaxes(1, 2)) + _gram(effector, effector))
        )
        if leg == 0:
            relative, arm = effector - elbow, arms[:, 0]
            turn = (
                arm[:, 0, np.newaxis] * relative[:, 1] - arm[:, 1, np.newaxis] * relative[:, 0]
            ) / mechanism.distal.length**2
            matrix += scene.payload.inertia * turn[:, :, np.newaxis] * turn[:, np.newaxis]
    return np.asarray(matrix + scene.payload.mass * _gram(effector, effector))


def _gram(first: RealArray, second: RealArray) -> RealArray:
    """Return the products A^T B of matrices (N, 2, 2)."""
    return np.asarray(first.swapaxes(1, 2) @ second)
