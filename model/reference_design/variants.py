"""The equations of motion of several variants of a robot at many instants, with exact Jacobians.

The parameters' derived values are arguments of the functions, so that all variants share one of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi
import numpy as np
from scipy.linalg import eigh

from flexfmu.model.five_bar import FiveBar, assemble
from flexfmu.model.scene.errors import EquilibriumError, SceneError
from flexfmu.model.scene.schema import Scene
from flexfmu.model.vectorised import Vectorised
from flexfmu.trajectories.jets import RealArray

ITERATIONS = 30
"""Largest number of Newton steps to a static equilibrium; three are usual."""

AT_ROUNDING = 1e-13
"""Change [m or rad] below which a static equilibrium is found."""


@dataclass(frozen=True, eq=False)
class RobotVariant:
    """A robot: a scene's, with other values of some parameters.

    Attributes:
        scene: the scene.
        changes: values of the FMU's parameters that differ from the scene's, by name, ``{"payload.mass": 4.2}`` for example.
    """

    scene: Scene
    changes: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Rest:
    """P variants at rest with locked motors.

    Attributes:
        elastic: elastic coordinates (P, n).
        position: end effector (P, 2) [m].
        torque: motor torques (P, 2) [N m].
        jacobian: derivatives of [forces, torques, position] by [q, v, a, u], (P, n + 4, 3 n + 6).
    """

    elastic: RealArray
    position: RealArray
    torque: RealArray
    jacobian: RealArray


@dataclass(frozen=True, eq=False)
class FreeModes:
    """Undamped modes of P variants about rest, in ascending order.

    Attributes:
        frequencies: angular frequencies (P, n) [rad/s].
        coordinates: matrices (P, n, n) from elastic coordinates to modal ones, with modes of unit mass.
        displacements: of the end effector by a unit of each modal coordinate, (P, 2, n) [m].
    """

    frequencies: RealArray
    coordinates: RealArray
    displacements: RealArray


class VariantModel:
    """Forces on the n elastic coordinates, motor torques and end effector of P variants of a robot.

    Args:
        scene: the robot.
        variants: values of the FMU's parameters that differ from the scene's, by name.

    Raises:
        SceneError: a parameter doesn't exist.
    """

    def __init__(self, scene: Scene, variants: Sequence[Mapping[str, float]]) -> None:
        five_bar = assemble(scene)
        motion = five_bar.motion
        self.n = motion.q_e.numel()
        self.parameters = _derived(five_bar, variants, scene.name)
        arguments = [motion.q_e, motion.v_e, motion.a_e, casadi.vertcat(motion.q_a, motion.v_a, motion.a_a)]
        results = casadi.densify(casadi.vertcat(five_bar.forces.elastic, five_bar.forces.motors, five_bar.position))
        jacobian = casadi.densify(casadi.jacobian(results, casadi.vertcat(*arguments)))
        parameters = five_bar.registry.d
        self._values = Vectorised(casadi.Function("values", [*arguments, parameters], [casadi.cse(results)]))
        linear = casadi.Function("linear", [*arguments, parameters], casadi.cse([results, jacobian]))
        self._linear = Vectorised(linear)

    def values(self, q: RealArray, v: RealArray, a: RealArray, references: RealArray) -> RealArray:
        """[forces, torques, position] at N instants of all variants, (P, N, n + 4).

        Args:
            q, v, a: elastic coordinates, rates and accelerations (P, N, n).
            references: [q_a, v_a, a_a] (N, 6).
        """
        return self._evaluated(self._values, q, v, a, references)[0]

    def linearised(
        self, q: RealArray, v: RealArray, a: RealArray, references: RealArray
    ) -> tuple[RealArray, RealArray]:
        """The same, and the derivatives by [q, v, a, references], (P, N, n + 4, 3 n + 6)."""
        values, by_columns = self._evaluated(self._linear, q, v, a, references)
        # CasADi's matrices lie column by column
        by = by_columns.reshape(*values.shape[:2], 3 * self.n + 6, self.n + 4).swapaxes(-1, -2)
        return values, np.ascontiguousarray(by)

    def rest(self, joints: RealArray) -> Rest:
        """The variants at rest with the motors locked at the angles (2,) [rad].

        Raises:
            EquilibriumError: Newton's method doesn't converge.
        """
        n, references = self.n, np.concatenate([joints, np.zeros(4)])[np.newaxis]
        q = np.zeros((len(self.parameters), 1, n))
        zeros = np.zeros_like(q)
        for _ in range(ITERATIONS):
            values, jacobian = self.linearised(q, zeros, zeros, references)
            change = np.linalg.solve(jacobian[:, 0, :n, :n], values[:, 0, :n, np.newaxis])[..., 0]
            size = np.abs(change).max(initial=0.0)
            if not np.isfinite(size):
                break
            if size < AT_ROUNDING:
                return Rest(q[:, 0], values[:, 0, n + 2 :], values[:, 0, n : n + 2], jacobian[:, 0])
            q[:, 0] -= change
        raise EquilibriumError(
            f"no static equilibrium with the motors at q11 = {joints[0]:.6g} rad, q21 = {joints[1]:.6g} rad: the pose may be "
            f"too near to a singularity or the links too soft for the load"
        )

    def _evaluated(
        self, function: Vectorised, q: RealArray, v: RealArray, a: RealArray, references: RealArray
    ) -> list[RealArray]:
        """The results of a function at all instants, each (P, N, size)."""
        count, instants, _ = q.shape
        u = np.broadcast_to(references, (count, instants, 6))
        parameters = np.repeat(self.parameters, instants, axis=0)
        points = [each.reshape(count * instants, -1) for each in (q, v, a, u)]
        return [each.reshape(count, instants, -1) for each in function([*points, parameters])]


def free_modes(rest: Rest) -> FreeModes:
    """Undamped modes about rest."""
    n = rest.elastic.shape[1]
    found = []
    for jacobian in rest.jacobian:
        stiffness, mass = jacobian[:n, :n], jacobian[:n, 2 * n : 3 * n]
        squares, shapes = eigh(0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T))
        found.append((np.sqrt(squares), shapes.T @ mass, jacobian[n + 2 :, :n] @ shapes))
    frequencies, coordinates, displacements = (np.array(each) for each in zip(*found, strict=True))
    return FreeModes(frequencies, coordinates, displacements)


def _derived(five_bar: FiveBar, variants: Sequence[Mapping[str, float]], name: str) -> RealArray:
    """Derived values of the variants' parameters (P, n_derived)."""
    registry = five_bar.registry
    derive = casadi.Function("derive", [registry.p], [registry.resolved()])
    start = {variable.name: float(variable.start or 0.0) for variable in registry.variables}
    for variant in variants:
        for key in variant.keys() - start.keys():
            raise SceneError(f"scene {name} has no parameter `{key}`; it has {', '.join(start)}")
    return np.array([derive(list((start | dict(variant)).values())).full().ravel() for variant in variants])
