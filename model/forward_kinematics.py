"""Rigid forward kinematics of the five-bar for jets: where joint references put the rigid end effector."""

from __future__ import annotations

from dataclasses import dataclass

from flexfmu.model.assembly import bases
from flexfmu.model.scene import Mechanism
from flexfmu.trajectories.jets import Jet, sincos, sqrt


@dataclass(frozen=True)
class RigidForwardKinematics:
    """Forward kinematics of a mechanism in its assembly mode; implements the shapers' `ForwardKinematics`."""

    mechanism: Mechanism

    def end_effector(self, q11: Jet, q21: Jet) -> tuple[Jet, Jet]:
        """Jets of the end effector's x and y [m] from jets of the joint angles [rad].

        Both elbows are at the distal length from it: it lies on the perpendicular through the middle between them.
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
