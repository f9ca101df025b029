"""Closed-form assembly of the flexible five-bar, which reduces its equations to the independent coordinates.

The elbows follow from the motor angles and the proximal deflections. The end effector is an intersection of two circles
about the elbows; their radii are the deformed lengths of the distal links, and the assembly mode selects the side.
Rates and accelerations follow from 2 x 2 systems: the paper's A, B, C (eq. 19), solved in closed form. The transposed
velocity map projects forces onto the independent coordinates and gives the joint reactions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi

from flexfmu.model.dynamics import RedundantState
from flexfmu.model.robot import LEGS, Robot, TipMap


@dataclass(frozen=True)
class IndependentMotion:
    """Motor angles q_a (2, 1) and elastic coordinates q_e (n, 1) with rates and accelerations, as symbols."""

    q_a: casadi.SX
    v_a: casadi.SX
    a_a: casadi.SX
    q_e: casadi.SX
    v_e: casadi.SX
    a_e: casadi.SX


@dataclass(frozen=True)
class ProjectedForces:
    """Generalised forces that a motion needs, and the joint reactions.

    Attributes:
        motors: forces on the motor angles (2, 1) [N m].
        elastic: forces on the elastic coordinates (n, 1) [N, N m].
        elbows: force of the proximal on the distal link at the elbow, of leg 1 and leg 2, each (2, 1) [N].
        pulls: force of leg 1 and of leg 2 on the end effector, each (2, 1) [N].
    """

    motors: casadi.SX
    elastic: casadi.SX
    elbows: tuple[casadi.SX, casadi.SX]
    pulls: tuple[casadi.SX, casadi.SX]


def _normal(direction: casadi.SX) -> casadi.SX:
    return casadi.vertcat(-direction[1], direction[0])


class Closure:
    """The motion of the assembled robot as expressions of the independent motion.

    Args:
        robot: symbols of the robot, for the bases and the tip displacements.
        motion: independent motion.
        lengths: proximal and distal length [m] as symbols.
        side: +1 where the end effector lies left of elbow 1 → elbow 2, -1 where right.
    """

    def __init__(
        self, robot: Robot, motion: IndependentMotion, lengths: tuple[casadi.SX, casadi.SX], side: int
    ) -> None:
        self._tips, self._motion, self._side = TipMap(robot), motion, side
        self._robot, self._lengths = robot, lengths
        proximal, distal = lengths
        # proximal links: angle, direction, displacements of the tips, elbows
        self.q_a = motion.q_a + self._twist(motion.q_e)
        self._bases = [robot.links[f"link{leg}1"].base for leg in LEGS]
        self.e_a = [casadi.vertcat(casadi.cos(self.q_a[i]), casadi.sin(self.q_a[i])) for i in range(2)]
        tip = self._tips.displacement
        self.reach = [proximal + tip(f"link{leg}1", "axial", motion.q_e) for leg in LEGS]
        self.sag = [tip(f"link{leg}1", "bending", motion.q_e) for leg in LEGS]
        # distal links: circles with the deformed lengths as radii meet at the end effector
        self.length = [distal + tip(f"link{leg}2", "axial", motion.q_e) for leg in LEGS]
        self.elbows = [
            b + e * r + _normal(e) * s for b, e, r, s in zip(self._bases, self.e_a, self.reach, self.sag, strict=True)
        ]
        self.position = self._intersect()
        self.e_p = [(self.position - p) / length for p, length in zip(self.elbows, self.length, strict=True)]
        self.sine = self.e_p[0][0] * self.e_p[1][1] - self.e_p[0][1] * self.e_p[1][0]
        self._move()
        self._accelerate()

    def _twist(self, coordinates: casadi.SX) -> casadi.SX:
        """Link minus motor angles (2, 1), or their rates, for q_e or its rate."""
        return self._tips.twist.T @ coordinates if coordinates.numel() else casadi.SX(2, 1)

    def _intersect(self) -> casadi.SX:
        """End effector X: intersection of two circles about the elbows."""
        (p1, p2), (l1, l2) = self.elbows, self.length
        line = p2 - p1
        square = casadi.dot(line, line)
        along = 0.5 + (l1 - l2) * (l1 + l2) / (2 * square)
        across = casadi.sqrt(l1**2 / square - along**2)
        return p1 + along * line + self._side * across * _normal(line)

    def _solve(self, right: list[casadi.SX]) -> casadi.SX:
        """Vector X with e_p[i]·X = right[i]."""
        (e1, e2), (r1, r2) = self.e_p, right
        return casadi.vertcat(r1 * e2[1] - r2 * e1[1], r2 * e1[0] - r1 * e2[0]) / self.sine

    def _solve_transposed(self, force: casadi.SX) -> list[casadi.SX]:
        """Coefficients m_i for which the sum of m_i e_p[i] equals the force: the axial forces in the distal links."""
        e1, e2 = self.e_p
        return [(force[0] * e2[1] - force[1] * e2[0]) / self.sine, (force[1] * e1[0] - force[0] * e1[1]) / self.sine]

    def _move(self) -> None:
        """Set the velocities: angular rates of the links, elbows, end effector."""
        m = self._motion
        # angular rates of the proximal links, rates of the tip displacements
        w_a = m.v_a + self._twist(m.v_e)
        self.w_a = [w_a[i] for i in range(2)]
        reach = [self._tips.rate(f"link{leg}1", "axial", m.q_e, m.v_e) for leg in LEGS]
        sag = [self._tips.rate(f"link{leg}1", "bending", m.q_e, m.v_e) for leg in LEGS]
        self.length_rate = [self._tips.rate(f"link{leg}2", "axial", m.q_e, m.v_e) for leg in LEGS]
        # components of the elbow velocity along and across the proximal link
        self._along = [reach[i] - self.w_a[i] * self.sag[i] for i in range(2)]
        self._across = [sag[i] + self.w_a[i] * self.reach[i] for i in range(2)]
        self.elbow_velocity = [self._along[i] * self.e_a[i] + self._across[i] * _normal(self.e_a[i]) for i in range(2)]
        # along each distal link: end-effector velocity = elbow velocity + elongation rate
        self.velocity = self._solve(
            [casadi.dot(self.e_p[i], self.elbow_velocity[i]) + self.length_rate[i] for i in range(2)]
        )
        # across it: the difference of both velocities gives the angular rate of the link
        self.w_p = [
            casadi.dot(_normal(self.e_p[i]), self.velocity - self.elbow_velocity[i]) / self.length[i] for i in range(2)
        ]
        self._reach_rate, self._sag_rate = reach, sag

    def _accelerate(self) -> None:
        """Set the accelerations: the time derivatives of the terms in `_move`."""
        m, w, wp = self._motion, self.w_a, self.w_p
        # angular accelerations of the proximal links, second derivatives of the tip displacements
        self.wd_a = m.a_a + self._twist(m.a_e)
        reach = [self._tips.acceleration(f"link{leg}1", "axial", m.q_e, m.v_e, m.a_e) for leg in LEGS]
        sag = [self._tips.acceleration(f"link{leg}1", "bending", m.q_e, m.v_e, m.a_e) for leg in LEGS]
        length = [self._tips.acceleration(f"link{leg}2", "axial", m.q_e, m.v_e, m.a_e) for leg in LEGS]
        # components of the elbow acceleration along and across the proximal link
        along = [reach[i] - self.wd_a[i] * self.sag[i] - w[i] * (self._sag_rate[i] + self._across[i]) for i in range(2)]
        across = [
            sag[i] + self.wd_a[i] * self.reach[i] + w[i] * (self._reach_rate[i] + self._along[i]) for i in range(2)
        ]
        self.elbow_acceleration = [along[i] * self.e_a[i] + across[i] * _normal(self.e_a[i]) for i in range(2)]
        # along the distal links: end effector, with the centripetal term; across them: their angular accelerations
        self.acceleration = self._solve(
            [
                casadi.dot(self.e_p[i], self.elbow_acceleration[i]) + length[i] - self.length[i] * wp[i] ** 2
                for i in range(2)
            ]
        )
        self.wd_p = [
            (
                casadi.dot(_normal(self.e_p[i]), self.acceleration - self.elbow_acceleration[i])
                - 2 * self.length_rate[i] * wp[i]
            )
            / self.length[i]
            for i in range(2)
        ]

    def position_at(self, q_e: casadi.SX) -> casadi.SX:
        """End effector (2, 1) [m] for other elastic coordinates (n, 1)."""
        return Closure(self._robot, replace(self._motion, q_e=q_e), self._lengths, self._side).position

    def redundant(self) -> RedundantState:
        """The motion in redundant coordinates."""
        m = self._motion
        return RedundantState(
            directions=(*self.e_a, *self.e_p),
            points=(self.elbows[0], self.elbows[1]),
            position=self.position,
            elastic=m.q_e,
            rates=casadi.vertcat(*self.w_a, *self.w_p, *self.elbow_velocity, self.velocity, m.v_e),
            accelerations=casadi.vertcat(self.wd_a, *self.wd_p, *self.elbow_acceleration, self.acceleration, m.a_e),
        )

    def project(self, force: casadi.SX) -> ProjectedForces:
        """Redundant generalised forces (10 + n, 1) projected onto the independent coordinates.

        This is the transposed velocity map; virtual power is preserved.
        """
        # redundant forces by coordinate: link angles, elbows, end effector, elastic coordinates
        turning_a, turning_p = force[0:2], force[2:4]
        required, at_tip, elastic = [force[4:6], force[6:8]], force[8:10], force[10:]
        # a moment on a distal link is a couple of forces at its ends; the remaining force at the end effector is axial
        levers = [turning_p[i] * _normal(self.e_p[i]) / self.length[i] for i in range(2)]
        axial = self._solve_transposed(at_tip + levers[0] + levers[1])
        pulls = [axial[i] * self.e_p[i] - levers[i] for i in range(2)]
        elbows = [required[i] + pulls[i] for i in range(2)]
        # elbow forces load the proximal links; tip forces load the elastic coordinates
        joints = []
        for i in range(2):
            along = casadi.dot(self.e_a[i], elbows[i])
            across = casadi.dot(_normal(self.e_a[i]), elbows[i])
            joints.append(turning_a[i] + across * self.reach[i] - along * self.sag[i])
            if elastic.numel():
                for link, direction, component in ((1, "axial", along), (1, "bending", across), (2, "axial", axial[i])):
                    elastic += self._tips.gain(f"link{i + 1}{link}", direction, self._motion.q_e) * component  # type: ignore[arg-type]
        # a twist of the transmission rotates the link relative to the motor
        motors = casadi.vertcat(*joints)
        if elastic.numel():
            elastic += self._tips.twist @ motors
        return ProjectedForces(motors, elastic, (elbows[0], elbows[1]), (pulls[0], pulls[1]))
