"""Static equilibrium (Newton's method) and natural frequencies of the finite elements, with locked motors; and their motion under
prescribed motor angles, by the Radau IIA method of order 5.

The unknowns of a step are the accelerations at its three stages; rates and coordinates follow from them. The equations
of motion hold at every stage. The last one is the end of the step, so that accelerations and torques have the accuracy of the
method; see `flexfmu.model.collocation`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import eigh, lu_factor, lu_solve

from flexfmu.model.collocation import collocation
from flexfmu.model.finite_elements.robot import HELD, MOTORS, FiniteElementRobot
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


METHOD = collocation("radau", 3)

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


def simulate(
    robot: FiniteElementRobot, joints: Trajectory, instants: RealArray, step: float, *, stages: bool = False
) -> ElementMotion:
    """Motion from the static equilibrium at the start; steps end at all breakpoints and instants.

    Args:
        robot: the finite elements.
        joints: motion of the motors [rad]; they stand still after its end.
        instants: instants to record (N,) [s], ascending, above zero.
        step: longest step [s]; the steps within an interval are equal.
        stages: whether to record all stages of all steps, inner ones of an order less, instead of the instants alone.

    Raises:
        EquilibriumError: the start has no static equilibrium, or the iteration of a step doesn't converge.
    """
    x = equilibrium(robot, joints.evaluate(0.0, 0)[0, 0]).coordinates
    v, a, before = np.zeros(x.size), np.zeros((x.size, 3)), 1.0
    end, motors = list(robot.mesh.end), list(MOTORS)
    factors, factors_step, times, states = None, 0.0, list[RealArray](), list[tuple[RealArray, RealArray, RealArray]]()
    # intervals between instants and breakpoints; a breakpoint that equals an instant but for rounding is dropped
    stop = float(instants[-1])
    breakpoints = [t for t in joints.breakpoints if t < stop and np.abs(instants - t).min() > SAME_TIME * stop]
    for start, finish in pairwise(sorted({0.0, *breakpoints, *instants.tolist()})):
        # equal steps within each interval; the motor motion at all stages at once
        count = math.ceil((finish - start) / step * (1.0 - 1e-9))
        h = (finish - start) / count
        times.append(start + h * (np.arange(count)[:, None] + METHOD.nodes).ravel())
        times[-1][-1] = finish
        driven = joints.evaluate(times[-1], 2, side="left").reshape(3, count, 3, 2)
        for n in range(count):
            # predict the accelerations by the parabola through the stages of the step before, and prescribe the motors
            x, v = x[:, None] + h * METHOD.nodes * v[:, None], v[:, None] + np.zeros(3)
            a = a @ np.linalg.solve(np.vander(METHOD.nodes, 3).T, np.vander(1.0 + h / before * METHOD.nodes, 3).T)
            before = h
            x[HELD:] += h**2 * a[HELD:] @ METHOD.twice.T
            v[HELD:] += h * a[HELD:] @ METHOD.matrix.T
            x[motors], v[motors], a[motors] = driven[:, n].transpose(0, 2, 1)
            # correct the stages' accelerations by Newton's method until the equations of motion hold
            for iteration in range(1, MAXIMUM_ITERATIONS + 1):
                # the iteration matrix at the middle stage, for a new step size or after `MANY` iterations
                if factors is None or abs(h - factors_step) > 1e-9 * h:
                    k, c, m = (each[HELD:, HELD:] for each in robot.tangents(x[:, 1], v[:, 1], a[:, 1]))
                    matrix = np.kron(np.eye(3), m) + h * np.kron(METHOD.matrix, c) + h**2 * np.kron(METHOD.twice, k)
                    factors, factors_step = lu_factor(matrix), h
                change = lu_solve(factors, -robot.forces(x, v, a)[HELD:].T.ravel()).reshape(3, -1).T
                a[HELD:] += change
                v[HELD:] += h * change @ METHOD.matrix.T
                x[HELD:] += h**2 * change @ METHOD.twice.T
                if iteration % MANY == 0:
                    factors = None
                if np.abs(change).max() <= CONVERGED * (SCALE + np.abs(a).max()):
                    break
            else:
                raise EquilibriumError(
                    f"the finite elements' forces don't balance at {times[-1][3 * n + 2]:.6g} s: take smaller steps than {h:.3g} s"
                )
            states.append((x, v, a))
            # the last stage is the new state
            x, v = x[:, -1], v[:, -1]
    time = np.concatenate(times)
    chosen = slice(None) if stages else np.isin(time, instants)
    x, v, a = (np.hstack(each)[:, chosen] for each in zip(*states, strict=True))
    return ElementMotion(time[chosen], x[end].T, v[end].T, a[end].T, robot.forces(x, v, a)[motors].T)
