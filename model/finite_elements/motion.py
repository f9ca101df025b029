"""Static equilibrium (Newton's method) and natural frequencies of the finite elements, with locked motors; and their motion under
prescribed motor angles, by the Radau IIA method of order 5.

The unknowns of a step are the accelerations at its three stages; rates and coordinates follow from them. The equations
of motion hold at every stage. The last one is the end of the step, so that accelerations and torques have the accuracy of the
method; see `flexfmu.model.radau`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, lu_factor, lu_solve

from flexfmu.model.finite_elements.robot import HELD, MOTORS, FiniteElementRobot
from flexfmu.model.radau import radau
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.trajectory import SAME_TIME, Trajectory

EQUILIBRIUM_ITERATIONS = 20

ROUNDING = 1e-13
"""The Newton iteration has converged when its step is below this [m, rad]: rounding of coordinates of about 1."""


@dataclass(frozen=True)
class RestState:
    """A static equilibrium.

    Attributes:
        coordinates: coordinates of all nodes (size,) [m, rad].
        position: end effector (2,) [m].
        torque: motor torques that hold the pose (2,) [N m].
    """

    coordinates: RealArray
    position: RealArray
    torque: RealArray


def equilibrium(robot: FiniteElementRobot, joints: RealArray) -> RestState:
    """Equilibrium with the motors locked at the angles (q11, q21) [rad].

    Raises:
        EquilibriumError: the Newton iteration doesn't converge.
    """
    # Newton iteration on the free coordinates; the motors stay locked
    x = robot.undeformed(joints)
    rest = np.zeros(x.size)
    for _ in range(EQUILIBRIUM_ITERATIONS):
        stiffness = robot.tangents(x, rest, rest)[0][HELD:, HELD:]
        step = np.linalg.solve(stiffness, -robot.forces(*_columns(x, rest, rest))[HELD:, 0])
        x[HELD:] += step
        if np.abs(step).max() < ROUNDING:
            # motor torques balance the forces on the motor angles
            torque = robot.forces(*_columns(x, rest, rest))[list(MOTORS), 0]
            return RestState(x, x[list(robot.mesh.end)], torque)
    raise EquilibriumError(
        f"no static equilibrium of the finite elements with the motors at q11 = {joints[0]:.6g} rad, q21 = {joints[1]:.6g} rad: "
        f"Newton's step is still {np.abs(step).max():.3g} m or rad after {EQUILIBRIUM_ITERATIONS} iterations"
    )


def element_frequencies(robot: FiniteElementRobot, joints: RealArray, count: int) -> RealArray:
    """The first undamped natural frequencies [Hz] about the static equilibrium, with the motors locked.

    Raises:
        EquilibriumError: there is no static equilibrium.
    """
    x = equilibrium(robot, joints).coordinates
    rest = np.zeros(x.size)
    stiffness, _, mass = (each[HELD:, HELD:] for each in robot.tangents(x, rest, rest))
    squares = eigh(
        0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T), eigvals_only=True, subset_by_index=(0, count - 1)
    )
    return np.asarray(np.sqrt(squares) / (2.0 * np.pi))


def _columns(*vectors: RealArray) -> tuple[RealArray, ...]:
    return tuple(vector[:, None] for vector in vectors)


Factors = tuple[RealArray, NDArray[np.int32]]

METHOD = radau(3)

CONVERGED = 1e-6
"""Newton's method has converged when no acceleration changes by more than this fraction of `SCALE` + the largest."""

SCALE = 10.0
"""Acceleration [m/s²] added to the scale of convergence: axial stiffness turns rounding of positions into 1e-7 m/s²."""

MANY = 6
"""The iteration matrix is computed again after this number of iterations."""

MAXIMUM_ITERATIONS = 30


@dataclass(frozen=True)
class ElementMotion:
    """Motion of the robot at N instants.

    Attributes:
        time: instants (N,) [s].
        position, velocity, acceleration: end-effector motion (N, 2) [m, m/s, m/s²].
        torque: motor torques (N, 2) [N m].
    """

    time: RealArray
    position: RealArray
    velocity: RealArray
    acceleration: RealArray
    torque: RealArray


def simulate(robot: FiniteElementRobot, joints: Trajectory, instants: RealArray, step: float) -> ElementMotion:
    """Motion from the static equilibrium at the start; steps end at all breakpoints and instants.

    Args:
        robot: the finite elements.
        joints: motion of the motors [rad]; they stand still after its end.
        instants: instants to record (N,) [s], ascending, above zero.
        step: longest step [s]; the steps within an interval are equal.

    Raises:
        EquilibriumError: the start has no static equilibrium, or the iteration of a step doesn't converge.
    """
    integration = _Integration(robot, joints.evaluate(0.0, 0)[0, 0])
    wanted = set(instants.tolist())
    # intervals between instants and breakpoints; a breakpoint that equals an instant but for rounding is dropped
    stop = float(instants[-1])
    breakpoints = [t for t in joints.breakpoints if t < stop and np.abs(instants - t).min() > SAME_TIME * stop]
    for begin, end in pairwise(sorted({0.0, *breakpoints, *instants.tolist()})):
        # equal steps within each interval; the motor motion at all stages at once
        count = math.ceil((end - begin) / step * (1.0 - 1e-9))
        h = (end - begin) / count
        stages = begin + h * (np.arange(count)[:, None] + METHOD.nodes)
        motors = joints.evaluate(stages.ravel(), 2, side="left").reshape(3, count, 3, 2)
        for n in range(count):
            integration.advance(float(stages[n, -1]), h, motors[:, n].transpose(0, 2, 1))
        if end in wanted:
            integration.record(end)
    return integration.motion()


class _Integration:
    """State of the integration: present motion, factorised iteration matrix and recorded instants."""

    def __init__(self, robot: FiniteElementRobot, joints: RealArray) -> None:
        self._robot = robot
        self._x = equilibrium(robot, joints).coordinates
        self._v, self._a, self._force = np.zeros((3, self._x.size))
        self._factors: Factors | None = None
        self._factors_step = 0.0
        self._recorded: list[tuple[float, RealArray, RealArray, RealArray, RealArray]] = []

    def advance(self, time: float, h: float, motors: RealArray) -> None:
        """Advance by a step h [s] to `time`; `motors` are angles, rates and accelerations (3, 2, stages)."""
        # predict with constant accelerations, prescribe the motors
        x = self._x[:, None] + h * METHOD.nodes * self._v[:, None]
        v, a = self._v[:, None] + np.zeros(3), self._a[:, None] + np.zeros(3)
        x[HELD:] += h**2 * a[HELD:] @ METHOD.twice.T
        v[HELD:] += h * a[HELD:] @ METHOD.matrix.T
        x[list(MOTORS)], v[list(MOTORS)], a[list(MOTORS)] = motors
        # correct until the equations of motion hold; the last stage is the new state
        force = self._balance(time, h, x, v, a)
        self._x, self._v, self._a, self._force = x[:, -1], v[:, -1], a[:, -1], force[:, -1]

    def _balance(self, time: float, h: float, x: RealArray, v: RealArray, a: RealArray) -> RealArray:
        """Solve for the stages' accelerations by Newton's method, in place; returns the final forces (size, 3)."""
        for iteration in range(1, MAXIMUM_ITERATIONS + 1):
            force = self._robot.forces(x, v, a)
            change = lu_solve(self._matrix(h, x[:, 1], v[:, 1], a[:, 1]), -force[HELD:].T.ravel()).reshape(3, -1).T
            a[HELD:] += change
            v[HELD:] += h * change @ METHOD.matrix.T
            x[HELD:] += h**2 * change @ METHOD.twice.T
            if iteration % MANY == 0:
                self._factors = None
            if np.abs(change).max() <= CONVERGED * (SCALE + np.abs(a).max()):
                return self._robot.forces(x, v, a)
        raise EquilibriumError(
            f"the finite elements' forces don't balance at {time:.6g} s: take smaller steps than {h:.3g} s"
        )

    def _matrix(self, h: float, x: RealArray, v: RealArray, a: RealArray) -> Factors:
        """LU factors of the iteration matrix at the middle stage, for a new step size or after `MANY` iterations."""
        if self._factors is None or abs(h - self._factors_step) > 1e-9 * h:
            k, c, m = (each[HELD:, HELD:] for each in self._robot.tangents(x, v, a))
            self._factors = lu_factor(
                np.kron(np.eye(3), m) + h * np.kron(METHOD.matrix, c) + h**2 * np.kron(METHOD.twice, k)
            )
            self._factors_step = h
        return self._factors

    def record(self, time: float) -> None:
        """Record the present state."""
        end, motors = list(self._robot.mesh.end), list(MOTORS)
        self._recorded.append((time, self._x[end], self._v[end], self._a[end], self._force[motors]))

    def motion(self) -> ElementMotion:
        """The motion at the recorded instants."""
        return ElementMotion(*(np.array(column) for column in zip(*self._recorded, strict=True)))
