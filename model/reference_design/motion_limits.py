"""Limits of joint references for several variants of a robot, as inequalities with exact derivatives.

All limits are g(x) <= slack of their group, with g relative to the limit, and x = [free coefficients of joint 1, of joint 2, T].
What remains of the vibration is bounded mode by mode: the sum over the modes of modal amplitude at the end of the motion times
displacement of the end effector by the mode. It bounds the free vibration after the motion. The amplitude of a mode, the length of
a vector [place, rate], is bounded by half planes in `DIRECTIONS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexfmu.model.reference_design.elastic_response import Response, joined
from flexfmu.model.reference_design.joint_spline import REST, JointSpline, derivative_matrix
from flexfmu.model.reference_design.variants import Rest, VariantModel, free_modes
from flexfmu.trajectories.jets import RealArray

Distances = Callable[[RealArray], tuple[RealArray, RealArray]]
"""Points (N, 2) [m] → distances (K, N) [m], negative where the end effector must not be, and their gradients (K, N, 2)."""

GROUPS = ("torque", "speed", "acceleration", "jerk", "clearance", "residual")
CLEARANCE, RESIDUAL = 4, 5

DEPTH = 1e-3
"""Depth [m] that counts as much as a torque twice as large as allowed."""

RESIDUAL_SCALE = 0.02
"""A residual vibration twice as large as allowed counts as much as a torque 2 % too large: it ends small anyway."""

DIRECTIONS = np.arange(8) * np.pi / 4
"""Normals [rad] of the half planes that bound the amplitude of a mode; with 8 of them to 8 %."""

WORST = 3
"""Number of variants whose torques and distances count at an instant: those of variants with similar payloads are similar."""

SLOW = 6.0
"""Modes up to this multiple of a variant's lowest frequency count; smooth references don't excite faster ones."""


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of a motion for P variants.

    Attributes:
        torque: largest magnitude of both motor torques (P, 2) [N m].
        speed, acceleration, jerk: largest magnitudes of the joint references [rad/s, rad/s², rad/s³].
        residual: largest displacement of the end effector by vibration after the motion [m].
        distances: to what the end effector must keep clear of.
    """

    torque: RealArray
    speed: float
    acceleration: float
    jerk: float
    residual: float
    distances: Distances


@dataclass(frozen=True, eq=False)
class Rows:
    """Inequalities at a motion: values g (R,), indices of their groups (R,), derivatives (R, m), and which can decide (R,)."""

    values: RealArray
    groups: NDArray[np.intp]
    jacobian: RealArray
    deciding: NDArray[np.bool_]


class LimitRows:
    """The limits of motions of one size, but for the residual vibration, row by row: references, torques, clearance.

    Args:
        limits: the limits.
        degree, intervals: of the splines.
    """

    def __init__(self, limits: MotionLimits, degree: int, intervals: int) -> None:
        self.limits = limits
        # the first and last coefficients of derivatives are zero
        self._matrices = [derivative_matrix(degree, intervals, k)[REST - k : k - REST] for k in (1, 2, 3)]
        self._largest = (limits.speed, limits.acceleration, limits.jerk)
        self.free = intervals + degree - 2 * REST

    def values(self, motion: JointSpline, response: Response) -> tuple[RealArray, NDArray[np.intp]]:
        """g (R,) and the groups (R,)."""
        found = [np.abs(each).ravel() - 1.0 for each in self._references(motion)]
        found.append((np.abs(response.torque) / self.limits.torque[:, np.newaxis] - 1.0).ravel())
        found.append(-self.limits.distances(response.position.reshape(-1, 2))[0].ravel() / DEPTH)
        groups = [np.full(each.size, group) for each, group in zip(found, (1, 2, 3, 0, 4), strict=True)]
        return np.concatenate(found), np.concatenate(groups)

    def rows(self, motion: JointSpline, response: Response) -> Rows:
        """The inequalities with derivatives."""
        values, groups = self.values(motion, response)
        m = 2 * self.free + 1
        found = []
        for k, (matrix, each, largest) in enumerate(
            zip(self._matrices, self._references(motion), self._largest, strict=True), 1
        ):
            block = np.zeros((len(matrix), 2, m))
            for joint in range(2):
                columns = slice(joint * self.free, (joint + 1) * self.free)
                block[:, joint, columns] = matrix[:, REST:-REST] / (largest * motion.duration**k)
            block[..., -1] = -k * each / motion.duration
            found.append((np.sign(each)[..., np.newaxis] * block).reshape(-1, m))
        signed = np.sign(response.torque) / self.limits.torque[:, np.newaxis]
        found.append((signed[..., np.newaxis] * response.torque_by).reshape(-1, m))
        gradient = self.limits.distances(response.position.reshape(-1, 2))[1]
        gradient = np.asarray(gradient).reshape(-1, *response.position.shape)
        found.append((-np.einsum("kpnj,pnjm->kpnm", gradient, response.position_by) / DEPTH).reshape(-1, m))
        return Rows(values, groups, np.concatenate(found), self._deciding(values, response))

    def _deciding(self, values: RealArray, response: Response) -> NDArray[np.bool_]:
        """Which rows can decide (R,): of torques and of distances those of the `WORST` variants at the same instant."""
        count, instants, joints = response.torque.shape
        found, first = np.ones(len(values), dtype=bool), 2 * sum(map(len, self._matrices))
        middle = first + response.torque.size
        parts = [(slice(first, middle), (1, count, instants * joints)), (slice(middle, None), (-1, count, instants))]
        for part, shape in parts if count > WORST else ():
            of_variants = values[part].reshape(shape)
            least = np.partition(of_variants, -WORST, axis=1)[:, -WORST, np.newaxis]
            found[part] = (of_variants >= least).ravel()
        return found

    def _references(self, motion: JointSpline) -> list[RealArray]:
        """Coefficients of speed, acceleration and jerk, each relative to its limit (n_k, 2)."""
        return [
            matrix @ motion.coefficients / (motion.duration**k * largest)
            for k, (matrix, largest) in enumerate(zip(self._matrices, self._largest, strict=True), 1)
        ]


class ResidualVibration:
    """Modal amplitudes of the vibration that remains at the end, in displacements of the end effector.

    Args:
        models: the variants of each scene.
        end: joint angles after the motion (2,) [rad].
    """

    def __init__(self, models: Sequence[VariantModel], end: RealArray) -> None:
        rests = [model.rest(end) for model in models]
        # from elastic coordinates and their rates at the end: (P, 2, k, n)
        self.matrices = joined([_to_amplitudes(rest) for rest in rests])
        self._rest = joined([rest.elastic for rest in rests])
        self.error = np.zeros((len(self._rest), 2, self._rest.shape[1]))

    def amplitudes(self, end: RealArray) -> RealArray:
        """Modal places and rates (P, 2, k) [m] for states at the end (P, 2, n), the grid's error added."""
        away = end + self.error
        away[:, 0] -= self._rest
        return np.asarray((self.matrices @ away[..., np.newaxis])[..., 0])

    def largest(self, end: RealArray) -> RealArray:
        """Bounds (P,) of the displacement of the end effector after the motion [m]."""
        return np.asarray(np.linalg.norm(self.amplitudes(end), axis=1).sum(axis=-1))


def _to_amplitudes(rest: Rest) -> RealArray:
    """Matrices (P, 2, k, n) from elastic coordinates and their rates to displacements of the end effector by the k slowest modes."""
    modes = free_modes(rest)
    count = int((modes.frequencies < SLOW * modes.frequencies[:, :1]).any(axis=0).sum())
    size = np.linalg.norm(modes.displacements, axis=1)[:, :count, np.newaxis]
    coordinates = modes.coordinates[:, :count] * size
    return np.stack([coordinates, coordinates / modes.frequencies[:, :count, np.newaxis]], axis=1)
