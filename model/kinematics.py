"""Rigid kinematics of the five-bar: inverse and forward kinematics of points and jets, and margins to singularities.

Base, elbow and end effector of a leg form a triangle with known sides: the law of cosines gives the motor angle, with
the sign of the working mode (type-1 singularities where a leg is stretched or folded). The end effector is an
intersection of two circles about the elbows, chosen by the assembly mode (type-2 singularities where the distal links
are parallel; Gosselin and Angeles, Singularity analysis of closed-loop kinematic chains, IEEE Trans. Robot. Autom. 6
(1990)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexfmu.model.scene.assembly import WORKING_MODES, bases, motor_angles
from flexfmu.model.scene.mechanism import Mechanism
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
    """Inverse kinematics in the working mode; implements `InverseKinematics` of `flexfmu.trajectories`."""

    mechanism: Mechanism

    def inverse(self, position: tuple[float, float]) -> tuple[float, float]:
        """Motor angles (q11, q21) [rad] that put the end effector at `position` [m].

        Raises:
            ValueError: the position is out of reach.
        """
        return motor_angles(self.mechanism, position)

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
                f"reach of leg {leg + 1}",
                "m",
                np.minimum(proximal + distal - d, d - abs(proximal - distal)),
                REACH_MARGIN,
            )
            for leg, d in enumerate(distances)
        ]
        # type 2: angle between the distal links
        return (*reaches, Margin(SINE_NAME, "1", self.sine(position), SINE_MARGIN))

    def sine(self, position: RealArray) -> RealArray:
        """Sine of the angle between the distal links at positions (N, 2) [m], shape (N,).

        It is negative in the other assembly mode, and NaN out of reach.
        """
        elbow1, elbow2 = self._elbows(position)
        line, arm = elbow2 - elbow1, position - elbow1
        side = 1.0 if self.mechanism.assembly_mode == "left" else -1.0
        return np.asarray(side * (line[:, 0] * arm[:, 1] - line[:, 1] * arm[:, 0]) / self.mechanism.distal.length**2)

    def _elbows(self, position: RealArray) -> list[RealArray]:
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


@dataclass(frozen=True)
class RigidForwardKinematics:
    """Forward kinematics in the assembly mode; implements the shapers' `ForwardKinematics`."""

    mechanism: Mechanism

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
