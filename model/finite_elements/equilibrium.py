"""Static equilibrium (Newton's method) and natural frequencies of the finite elements, with locked motors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from flexfmu.model.finite_elements.robot import HELD, MOTORS, FiniteElementRobot
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.trajectories.jets import RealArray

MAXIMUM_ITERATIONS = 20

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
    for _ in range(MAXIMUM_ITERATIONS):
        stiffness = robot.tangents(x, rest, rest)[0][HELD:, HELD:]
        step = np.linalg.solve(stiffness, -robot.forces(*_columns(x, rest, rest))[HELD:, 0])
        x[HELD:] += step
        if np.abs(step).max() < ROUNDING:
            # motor torques balance the forces on the motor angles
            torque = robot.forces(*_columns(x, rest, rest))[list(MOTORS), 0]
            return RestState(x, x[list(robot.mesh.end)], torque)
    raise EquilibriumError(
        f"no static equilibrium of the finite elements with the motors at q11 = {joints[0]:.6g} rad, q21 = {joints[1]:.6g} rad: "
        f"Newton's step is still {np.abs(step).max():.3g} m or rad after {MAXIMUM_ITERATIONS} iterations"
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
