"""Elastic motion under joint references, for several variants of a robot at once, with derivatives by the references.

In the normalised time s = t / T the equations of motion F(q, q'/T, q''/T², u) = 0 are integrated by Gauss's method with three stages.
Its unknowns z are q'' at the stages; q' and q follow linearly, whatever T. Newton's method runs over the whole motion: the
matrices of all steps are inverted at once, and a recursion from step to step solves the linear equations. The same recursion
with the columns dF/du du/dx as loads gives the derivatives of the discrete solution by all design variables x, exactly
(implicit function theorem).

Derived values of the parameters are arguments of the functions, so that all variants of a scene share them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, reduce
from itertools import groupby
from typing import Any, Self

import casadi
import numpy as np
from numpy.typing import NDArray

from flexfmu.model.beams import LINKS, fibre_strains
from flexfmu.model.collocation import collocation
from flexfmu.model.five_bar import FiveBar, assemble
from flexfmu.model.reference_design.joint_spline import DesignedMotion
from flexfmu.model.scene.errors import EquilibriumError, SceneError
from flexfmu.model.scene.schema import Scene
from flexfmu.model.vectorised import Vectorised
from flexfmu.trajectories.jets import RealArray

PointFunction = Callable[[Sequence[RealArray]], list[RealArray]]
"""Arguments (N, size), one row for each point → results (N, size)."""

Evaluate = Callable[[casadi.Function], PointFunction]
"""Makes a function of N points from one of scalar operations with dense vectors."""

METHOD = collocation("legendre", 3)

CONVERGED, COMPARED = 1e-11, 1e-9
"""Newton's method has converged when no elastic coordinate changes by more [m or rad]; positions are wanted to 1e-7 m. The second is for
motions that are only compared: the last change is an order of magnitude smaller than the one before."""

ITERATIONS = 30
"""Largest number of Newton steps, of a motion or to a static equilibrium; three are usual for the latter."""

RENEWED, CONTRACTS = 10, 0.5
"""The matrices are renewed where more iterations than this are left at the rate of the last one, since a renewal takes as long as these,
or where a change is larger than this share of the one before."""

SHARED = 8
"""Steps of a fleet, or of a long motion, that share a matrix: an eighth of the time for a renewal and of its memory, and two or three iterations more."""

COLUMNS = 32
"""Variables whose derivatives are found together, for the sake of memory."""

TOGETHER = 3
"""Variants that are solved together: as many as processor caches hold."""


@dataclass(frozen=True, eq=False)
class Response:
    """Motion of P variants with n elastic coordinates at N stages, with derivatives by m design variables.

    Attributes:
        position: end effector (P, N, 2) [m].
        torque: motor torques (P, N, 2) [N m].
        end: elastic coordinates and their rates at the end of the motion (P, 2, n) [m, m/s].
        position_by, torque_by: derivatives (P, N, 2, m), stored in single precision; m is 0 where none are wanted.
        end_by: derivatives (P, 2, n, m), in single precision too.
        loads, loads_by: the further outputs (P, N, r) that were asked for, and their derivatives (P, N, r, m), as these.
        references, references_by: angles, speeds and accelerations of the joints (3, N, 2) [rad, rad/s, rad/s²] that it responds to, and
            their derivatives (N, 6, m).
        duration: of the motion [s].
    """

    position: RealArray
    torque: RealArray
    end: RealArray
    position_by: RealArray
    torque_by: RealArray
    end_by: RealArray
    loads: RealArray
    loads_by: RealArray
    references: RealArray
    references_by: RealArray
    duration: float


class ElasticResponse:
    """The elastic response of P robots, each with its own elastic coordinates, to the same references of their joints, from static equilibrium.

    Args:
        robots: the robots; those of one scene follow each other.
        start: joint angles before the motion (2,) [rad].
        steps: number of equal steps of the integration.
        loads: further outputs, in the order of `LINK_LOADS`.
        accuracy: change of an elastic coordinate [m or rad] below which Newton's method ends.
        shared: number of steps, at most, that share a matrix of Newton's method where no derivatives are wanted.

    Attributes:
        models: the robots, those that are solved together in one.
        starts: them at rest before the motion.
        fractions: of a motion's duration, at which references are wanted (N,).

    Raises:
        SceneError: a parameter doesn't exist.
        EquilibriumError: there is no static equilibrium at the start.
    """

    def __init__(
        self,
        robots: Sequence[RobotVariant],
        start: RealArray,
        steps: int,
        loads: tuple[str, ...] = (),
        accuracy: float = CONVERGED,
        shared: int = 1,
    ) -> None:
        scenes = [[*group] for _, group in groupby(robots, key=lambda each: id(each.scene))]
        groups = [group[k : k + TOGETHER] for group in scenes for k in range(0, len(group), TOGETHER)]
        self.models = [VariantModel(group, loads) for group in groups]
        self.fractions = ((np.arange(steps)[:, np.newaxis] + METHOD.nodes) / steps).ravel()
        shared = math.gcd(steps, shared)
        self.starts = [model.rest(start) for model in self.models]
        pairs = zip(self.models, self.starts, strict=True)
        self._parts = [_Integration(*each, steps, accuracy, shared) for each in pairs]

    def of_motion(self, motion: DesignedMotion, *, derivatives: bool = True) -> Response:
        """The response to a motion from rest to rest, with derivatives by its variables.

        Raises:
            EquilibriumError: Newton's method doesn't converge.
        """
        by = motion.derivatives(self.fractions) if derivatives else None
        return self.respond(np.hstack(list(motion.evaluate(self.fractions))), motion.duration, by)

    def respond(self, references: RealArray, duration: float, by: RealArray | None = None) -> Response:
        """The response to joint references; the end states of robots with fewer coordinates end with zeros.

        Args:
            references: [q_a, v_a, a_a] at ``fractions``, (N, 6) [rad, rad/s, rad/s²].
            duration: duration T of the motion [s].
            by: derivatives of the references by design variables at constant fractions, (N, 6, m), of which the last one is T; None for no
                derivatives.

        Raises:
            EquilibriumError: Newton's method doesn't converge.
        """
        by = np.empty((len(references), 6, 0)) if by is None else by
        found = [part.respond(references, duration, by) for part in self._parts]
        outputs, end, outputs_by, end_by = (joined(each) for each in zip(*found, strict=True))
        torque, position, loads = np.split(outputs, (2, 4), axis=2)
        torque_by, position_by, loads_by = np.split(outputs_by, (2, 4), axis=2)
        of_time = references.reshape(-1, 3, 2).swapaxes(0, 1)
        return Response(position, torque, end, position_by, torque_by, end_by, loads, loads_by, of_time, by, duration)

    def transfer(self, duration: float) -> RealArray:
        """Elastic coordinates and rates at the end of the last motion by those at its start, (P, 2, n, 2, n)."""
        found = joined([part.matrices.transfer for part in self._parts if part.matrices])
        found[:, 1] /= duration
        found[..., 1, :] *= duration
        return found


def joined(arrays: Sequence[RealArray]) -> RealArray:
    """Arrays one after the other along their first axis, the others filled up with zeros."""
    if len(arrays) == 1:
        return arrays[0]
    shape = sum(map(len, arrays)), *np.max([each.shape[1:] for each in arrays], axis=0)
    whole = np.zeros(shape, arrays[0].dtype)
    first = 0
    for each in arrays:
        whole[(slice(first, first + len(each)), *map(slice, each.shape[1:]))] = each
        first += len(each)
    return whole


class _Integration:
    """The elastic motion of variants that are solved together; arguments as of `ElasticResponse`."""

    def __init__(self, model: VariantModel, start: Rest, steps: int, accuracy: float, shared: int) -> None:
        self._model, self._steps, self._accuracy, self._shared = model, steps, accuracy, shared
        self._start = start.elastic[:, np.newaxis]
        # stage values z and the matrices from which the next solution starts
        self._guess = np.zeros((len(self._start), 3 * steps, model.n))
        self.matrices: _Matrices | None = None

    def respond(self, references: RealArray, duration: float, by: RealArray) -> tuple[RealArray, ...]:
        """The outputs (P, N, k) and the end state (P, 2, n), and their derivatives by design variables."""
        z, n = self._solved(references, duration), self._model.n
        q, v, end = self._integrated(z, self._start)
        end[:, 1] /= duration
        if not by.shape[2]:
            outputs = self._model.values(q, v / duration, z / duration**2, references)[..., n:]
            return outputs, end, np.empty((*outputs.shape, 0)), np.empty((*end.shape, 0))
        values, by_z, by_state, by_references = self._linearised(z, references, duration)
        matrices = _Matrices(self._steps, by_z, by_state).kept()
        # single precision is enough for programmes
        single: list[NDArray[Any]] = [each.astype(np.float32) for each in (by_z, by_state, by_references, by)]
        outputs_by, end_by = matrices.derivatives(*single)
        self.matrices = matrices.kept(self._shared)
        end_by[:, 1] /= duration
        end_by[:, 1, :, -1] -= end[:, 1] / duration
        return values[..., n:], end, outputs_by, end_by

    def _solved(self, references: RealArray, duration: float) -> RealArray:
        """Stage values z (P, N, n) that satisfy the equations of motion, by Newton's method with kept matrices."""
        z, before, n = self._guess, math.inf, self._model.n
        matrices = self.matrices or self._renewed(z, references, duration)
        q, v, _ = self._integrated(z, self._start)
        for _ in range(ITERATIONS):
            forces = self._model.values(q, v / duration, z / duration**2, references)[..., :n]
            change = matrices.solved(forces)
            of_q, of_v, _ = self._integrated(change, 0.0)
            z, q, v, size = z - change, q - of_q, v - of_v, float(np.abs(of_q).max(initial=0.0))
            if size < self._accuracy:
                self._guess = z
                return z
            if not np.isfinite(size) or size > 1.0:
                break
            rate = size / before
            if rate > CONTRACTS or rate**RENEWED * size > self._accuracy:
                matrices = self._renewed(z, references, duration)
            before = size
        # the next motion starts anew
        self._guess, self.matrices = np.zeros_like(z), None
        raise EquilibriumError(
            f"the elastic motion in {duration:.6g} s has no solution: the links are too soft for its loads"
        )

    def _integrated(self, z: RealArray, start: RealArray | float) -> tuple[RealArray, RealArray, RealArray]:
        """q and q' at all stages (P, N, n), and both at the end (P, 2, n), from z, at rest at the start."""
        h, of_step = 1.0 / self._steps, z.reshape(len(z), self._steps, 3, -1)
        # at the start of each step and at the end of the last one
        place, rate = np.zeros((2, len(z), self._steps + 1, z.shape[2]))
        np.cumsum(h * (METHOD.whole @ of_step), axis=1, out=rate[:, 1:])
        np.cumsum(h * h * (METHOD.whole_twice @ of_step) + h * rate[:, :-1], axis=1, out=place[:, 1:])
        place += start
        places, rates = place[:, :-1, np.newaxis], rate[:, :-1, np.newaxis]
        q = places + (h * METHOD.nodes)[:, np.newaxis] * rates + h * h * (METHOD.twice @ of_step)
        v = rates + h * (METHOD.matrix @ of_step)
        return q.reshape(z.shape), v.reshape(z.shape), np.stack([place[:, -1], rate[:, -1]], axis=1)

    def _renewed(self, z: RealArray, references: RealArray, duration: float) -> _Matrices:
        self.matrices = None
        _, by_z, by_state, _ = self._linearised(z, references, duration, self._shared)
        self.matrices = _Matrices(self._steps, by_z, by_state).kept()
        return self.matrices

    def _linearised(
        self, z: RealArray, references: RealArray, duration: float, shared: int = 1
    ) -> tuple[RealArray, RealArray, RealArray, RealArray]:
        """[forces, k outputs] at three stages of the step in the middle of each ``shared`` ones, of S steps.

        Returns:
            Their values (P, 3 S, n + k), and their derivatives (P, S, 3, n + k, ...): by z of all stages of the step (3 n), by the state
            [q, q'] at its start (2 n), and at constant z by [q_a, v_a, a_a, T] (7).
        """
        (q, rate, _), h, n = self._integrated(z, self._start), 1.0 / self._steps, self._model.n
        some = np.arange(3 * self._steps).reshape(-1, shared, 3)[:, shared // 2].ravel()
        q, rate, z = q[:, some], rate[:, some], z[:, some]
        values, jacobian = self._model.linearised(q, rate / duration, z / duration**2, references[some])
        by = jacobian.reshape(len(z), -1, 3, *jacobian.shape[2:])
        by_q, by_v, by_a = (by[..., i * n : (i + 1) * n] / duration**i for i in range(3))
        # of stage i by z of stage j
        by_z = h * h * METHOD.twice[:, np.newaxis, :, np.newaxis] * by_q[..., np.newaxis, :]
        by_z += h * METHOD.matrix[:, np.newaxis, :, np.newaxis] * by_v[..., np.newaxis, :]
        for i in range(3):
            by_z[:, :, i, :, i] += by_a[:, :, i]
        by_state = np.concatenate([by_q, by_v + h * METHOD.nodes[:, np.newaxis, np.newaxis] * by_q], axis=-1)
        rate, z = (each.reshape(*by_q.shape[:3], n, 1) for each in (rate, z))
        by_duration = (by_v @ rate + 2.0 * (by_a @ z)) / -duration
        by_references = np.concatenate([by[..., 3 * n :], by_duration], axis=-1)
        return values, by_z.reshape(*by_z.shape[:4], 3 * n), by_state, by_references


class _Matrices:
    """The linear equations of all steps: z = inverse loads - by_state s in each, with the state s = [q, q'] at its start.

    Args:
        steps: number of steps; if they are more than those of the equations, as many follow each other with the same ones.
        by_z, by_state: derivatives of forces and outputs, see `_Integration`.
    """

    def __init__(self, steps: int, by_z: RealArray, by_state: RealArray) -> None:
        count, some, *_ = by_z.shape
        n = by_z.shape[-1] // 3
        self._steps, h = steps, 1.0 / steps
        of_forces = by_z[:, :, :, :n].reshape(count, some, 3 * n, 3 * n)
        self._inverse: NDArray[Any] = np.linalg.inv(of_forces)
        self._by_state: NDArray[Any] = self._inverse @ by_state[:, :, :, :n].reshape(count, some, 3 * n, 2 * n)
        self._weights: NDArray[Any] = np.stack([h * h * METHOD.whole_twice, h * METHOD.whole])
        self._transition = np.kron(np.array([[1.0, h], [0.0, 1.0]]), np.eye(n)) - self._added(self._by_state)

    def kept(self, shared: int = 1) -> Self:
        """What Newton's method needs, for which single precision is enough: the matrices in the middle of each ``shared`` ones."""
        some = slice(shared // 2, None, shared)
        self._inverse = self._inverse[:, some].astype(np.float32)
        self._by_state = self._by_state[:, some].astype(np.float32)
        self._transition, self._weights = self._transition.astype(np.float32), self._weights.astype(np.float32)
        return self

    def solved(self, loads: RealArray) -> RealArray:
        """z (P, N, n) under loads on the stages of the same shape, from rest."""
        count, some, size, _ = self._inverse.shape
        # steps with the same matrices as columns
        right = loads.reshape(count, some, self._steps // some, size).swapaxes(2, 3)
        found: RealArray = self._inverse @ right.astype(self._inverse.dtype)
        states = self._states(self._added(found).swapaxes(2, 3).reshape(count, self._steps, 2 * size // 3, 1))
        states = states[:, :-1].reshape(count, some, self._steps // some, 2 * size // 3).swapaxes(2, 3)
        found -= self._by_state @ states.astype(self._by_state.dtype)
        return found.swapaxes(2, 3).reshape(loads.shape)

    def derivatives(
        self, by_z: RealArray, by_state: RealArray, by_references: RealArray, by: RealArray
    ) -> tuple[RealArray, RealArray]:
        """Derivatives of the outputs (P, N, k, m) and of the end state [q, q'] (P, 2, n, m).

        Args:
            by_z, by_state, by_references: derivatives of forces and outputs in all steps, see `_Integration`.
            by: derivatives of the references by design variables, see `ElasticResponse.respond`.
        """
        (count, steps, _, rows, _), m, n = by_references.shape, by.shape[-1], self._inverse.shape[-1] // 3
        # z eliminated
        k, of_forces = rows - n, self._added(self._inverse)
        by_z = by_z[:, :, :, n:].reshape(count, steps, 3 * k, 3 * n)
        by_state = by_state[:, :, :, n:].reshape(count, steps, 3 * k, 2 * n) - by_z @ self._by_state
        by_z = by_z @ self._inverse
        out = np.empty((count, steps, 3 * k, m), dtype=np.float32)
        end = np.empty((count, 2, n, m))
        for first in range(0, m, COLUMNS):
            some = slice(first, first + COLUMNS)
            explicit = by_references[..., :6] @ by[..., some].reshape(1, steps, 3, 6, -1)
            if some.stop >= m:
                explicit[..., -1] += by_references[..., 6]
            # sizes are written out: rigid robots have n = 0
            width = explicit.shape[-1]
            loads = -explicit[..., :n, :].reshape(count, steps, 3 * n, width)
            states = self._states(of_forces @ loads)
            found = by_z @ loads
            found += by_state @ states[:, :-1]
            found += explicit[..., n:, :].reshape(found.shape)
            out[..., some] = found
            end[..., some] = states[:, -1].reshape(count, 2, n, width)
        return out.reshape(count, 3 * steps, k, m), end

    @property
    def transfer(self) -> RealArray:
        """The last state by the first, (P, 2, n, 2, n)."""
        _, some, size, _ = self._transition.shape
        found = np.linalg.matrix_power(self._transition, self._steps // some)
        whole = reduce(lambda before, k: found[:, k] @ before, range(1, some), found[:, 0])
        return whole.reshape(len(whole), 2, size // 2, 2, size // 2)

    def _added(self, z: RealArray) -> RealArray:
        """What z (P, S, 3 n, r) of steps add to the next states (P, S, 2 n, r)."""
        count, steps, size, columns = z.shape
        return (self._weights @ z.reshape(count, steps, 3, size // 3 * columns)).reshape(
            count, steps, 2 * size // 3, columns
        )

    def _states(self, loads: RealArray) -> RealArray:
        """States (P, steps + 1, 2 n, r) from rest, with additions (P, steps, 2 n, r) in each step."""
        count, steps, size, columns = loads.shape
        states = np.zeros((count, steps + 1, size, columns), loads.dtype)
        for k in range(steps):
            states[:, k + 1] = self._transition[:, k * self._transition.shape[1] // steps] @ states[:, k] + loads[:, k]
        return states


PLACES = 5
"""Number of places of a link, equally spaced from its base to its tip, at which stresses are outputs; the largest are at the base and the middle."""

AT_ROUNDING = 1e-13
"""Change [m or rad] below which a static equilibrium is found."""


@dataclass(frozen=True, eq=False)
class RobotVariant:
    """A robot: a scene's, with other values of some parameters.

    Attributes:
        scene: the scene.
        changes: values of the FMU's parameters that differ from the scene's, by name, ``{"payload.mass": 4.2}`` for example.
        evaluate: makes its functions, which are evaluated at many points at once, by numpy or compiled.
    """

    scene: Scene
    changes: Mapping[str, float] = field(default_factory=dict)
    evaluate: Evaluate = Vectorised


@dataclass(frozen=True, eq=False)
class Rest:
    """P variants at rest with locked motors, and their free vibration about it.

    Attributes:
        elastic: elastic coordinates (P, n).
        position: end effector (P, 2) [m].
        torque: motor torques (P, 2) [N m].
        stiffness, damping, mass: derivatives (P, n, n) of the forces on the elastic coordinates by these, their rates and accelerations.
        displacement: derivatives (P, 2, n) of the end effector by them.
    """

    elastic: RealArray
    position: RealArray
    torque: RealArray
    stiffness: RealArray
    damping: RealArray
    mass: RealArray
    displacement: RealArray

    @property
    def modes(self) -> tuple[RealArray, RealArray]:
        """Undamped modes in ascending order: angular frequencies (P, n) [rad/s], and shapes with unit mass as columns (P, n, n)."""
        # coordinates of unit mass
        unit = np.linalg.inv(np.linalg.cholesky(self.mass))
        stiffness = 0.5 * (self.stiffness + self.stiffness.swapaxes(1, 2))
        squares, vectors = np.linalg.eigh(unit @ stiffness @ unit.swapaxes(1, 2))
        return np.sqrt(squares), unit.swapaxes(1, 2) @ vectors

    @property
    def system(self) -> RealArray:
        """Matrices (P, 2 n, 2 n) of the free vibration: rates and accelerations by elastic coordinates and rates."""
        accelerations = np.linalg.solve(self.mass, -np.concatenate([self.stiffness, self.damping], axis=2))
        rates = np.eye(accelerations.shape[2])[accelerations.shape[1] :]
        return np.concatenate([np.broadcast_to(rates, accelerations.shape), accelerations], axis=1)


class VariantModel:
    """Forces on the n elastic coordinates, motor torques and end effector of P variants of a robot.

    Args:
        robots: the variants, of one scene.
        loads: further outputs, in the order of `LINK_LOADS`.

    Raises:
        SceneError: a parameter doesn't exist.
    """

    def __init__(self, robots: Sequence[RobotVariant], loads: tuple[str, ...] = ()) -> None:
        scene = robots[0].scene
        five_bar, self._values, self._linear, derive = _functions(scene, robots[0].evaluate, loads)
        self.n = five_bar.elastic.numel()
        start = {variable.name: float(variable.start or 0.0) for variable in five_bar.registry.variables}
        for robot in robots:
            for key in robot.changes.keys() - start.keys():
                raise SceneError(f"scene {scene.name} has no parameter `{key}`; it has {', '.join(start)}")
        values = [[*(start | dict(robot.changes)).values()] for robot in robots]
        self._parameters = np.array([derive(each).full().ravel() for each in values])

    def values(self, q: RealArray, v: RealArray, a: RealArray, references: RealArray) -> RealArray:
        """[forces, torques, position, loads] at N instants of all variants, (P, N, n + k).

        Args:
            q, v, a: elastic coordinates, rates and accelerations (P, N, n).
            references: [q_a, v_a, a_a] (N, 6).
        """
        return self._evaluated(self._values, q, v, a, references)[0]

    def linearised(
        self, q: RealArray, v: RealArray, a: RealArray, references: RealArray
    ) -> tuple[RealArray, RealArray]:
        """The same, and the derivatives by [q, v, a, references], (P, N, n + k, 3 n + 6)."""
        values, by_columns = self._evaluated(self._linear, q, v, a, references)
        # CasADi's matrices lie column by column
        by = by_columns.reshape(*values.shape[:2], 3 * self.n + 6, values.shape[2]).swapaxes(-1, -2)
        return values, np.ascontiguousarray(by)

    def rest(self, joints: RealArray) -> Rest:
        """The variants at rest with the motors locked at the angles (2,) [rad].

        Raises:
            EquilibriumError: Newton's method doesn't converge.
        """
        n, references = self.n, np.concatenate([joints, np.zeros(4)])[np.newaxis]
        q = np.zeros((len(self._parameters), 1, n))
        zeros = np.zeros_like(q)
        for _ in range(ITERATIONS):
            values, jacobian = self.linearised(q, zeros, zeros, references)
            change = np.linalg.solve(jacobian[:, 0, :n, :n], values[:, 0, :n, np.newaxis])[..., 0]
            size = np.abs(change).max(initial=0.0)
            if not np.isfinite(size):
                break
            if size < AT_ROUNDING:
                torque, position, _ = np.split(values[:, 0, n:], (2, 4), axis=1)
                stiffness, damping, mass = np.split(jacobian[:, 0, :n, : 3 * n], 3, axis=2)
                return Rest(q[:, 0], position, torque, stiffness, damping, mass, jacobian[:, 0, n + 2 : n + 4, :n])
            q[:, 0] -= change
        raise EquilibriumError(
            f"no static equilibrium with the motors at q11 = {joints[0]:.6g} rad, q21 = {joints[1]:.6g} rad: the pose may be "
            f"too near to a singularity or the links too soft for the load"
        )

    def _evaluated(
        self, function: PointFunction, q: RealArray, v: RealArray, a: RealArray, references: RealArray
    ) -> list[RealArray]:
        """The results of a function at all instants, each (P, N, size)."""
        count, instants, _ = q.shape
        u = np.broadcast_to(references, (count, instants, 6))
        parameters = np.repeat(self._parameters, instants, axis=0)
        points = [each.reshape(count * instants, -1) for each in (q, v, a, u)]
        return [each.reshape(count, instants, -1) for each in function([*points, parameters])]


NO_FORCE = 1e-6
"""Force [N] below which magnitudes are rounded: that of no force at all has no derivative."""


def _reactions(scene: Scene, five_bar: FiveBar) -> casadi.SX:
    """Magnitudes (4,) of the forces in the elbows and between the legs and the end effector [N]."""
    return casadi.vertcat(
        *(casadi.sqrt(casadi.sumsqr(each) + NO_FORCE**2) for each in (*five_bar.forces.elbows, *five_bar.forces.pulls))
    )


def _stresses(scene: Scene, five_bar: FiveBar) -> casadi.SX:
    """Stresses [Pa] of both outer fibres of the four links at `PLACES`; zero where links are rigid."""
    places, found = np.linspace(0.0, 1.0, PLACES), list[casadi.SX]()
    q = dict(zip(five_bar.robot.elastic_names, casadi.vertsplit(five_bar.elastic), strict=True))
    for link, group in LINKS:
        modulus = five_bar.registry.derived("youngs_modulus", five_bar.links[group].youngs_modulus)
        bending, axial = casadi.SX.zeros(PLACES), casadi.SX.zeros(PLACES)
        for name, gain in zip(*fibre_strains(scene, link, group, "bending", places), strict=True):
            bending += q[name] * casadi.DM(gain)
        for name, gain in zip(*fibre_strains(scene, link, group, "axial", places), strict=True):
            axial += q[name] * casadi.DM(gain)
        found += [modulus * (axial + bending), modulus * (axial - bending)]
    return casadi.vertcat(*found)


LINK_LOADS: Mapping[str, tuple[int, Callable[[Scene, FiveBar], casadi.SX]]] = {
    "reaction": (4, _reactions),
    "stress": (8 * PLACES, _stresses),
}
"""Loads of joints and links that a response can have → how many there are, and their expressions."""


@lru_cache(maxsize=8)
def _functions(
    scene: Scene, evaluate: Evaluate, loads: tuple[str, ...] = ()
) -> tuple[FiveBar, PointFunction, PointFunction, casadi.Function]:
    """A scene's robot with functions for all values of its parameters.

    Returns:
        The robot; [forces, torques, position, loads] by [q], [v], [a], [q_a, v_a, a_a] and the derived parameters; the same, and their
        derivatives by all but the parameters; derived parameters by the parameters.
    """
    five_bar = assemble(scene)
    further = [LINK_LOADS[name][1](scene, five_bar) for name in loads]
    motion, parameters = five_bar.motion, five_bar.registry.d
    arguments = [motion.q_e, motion.v_e, motion.a_e, casadi.vertcat(motion.q_a, motion.v_a, motion.a_a)]
    results = casadi.densify(
        casadi.vertcat(five_bar.forces.elastic, five_bar.forces.motors, five_bar.position, *further)
    )
    jacobian = casadi.densify(casadi.jacobian(results, casadi.vertcat(*arguments)))
    values = casadi.Function("values", [*arguments, parameters], [casadi.cse(results)])
    linear = casadi.Function("linear", [*arguments, parameters], casadi.cse([results, jacobian]))
    derive = casadi.Function("derive", [five_bar.registry.p], [five_bar.registry.resolved()])
    return five_bar, evaluate(values), evaluate(linear), derive
