"""Static equilibrium of the flexible robot with locked motors, by Newton's method with step halving.

The stiffness matrix is exact, so convergence is quadratic. Near the solution the elastic forces of stiff families
cancel to rounding; a step then needn't reduce the residual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexfmu.model.numeric import NumericModel, numeric_model, standstill
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray

MAXIMUM_ITERATIONS = 50
"""Largest number of Newton iterations; three are usual, as deflections are small."""

RELATIVE_STEP = 1e-14
"""The iteration has converged when the norm of a Newton step is at most this fraction of that of the coordinates."""

SMALLEST_DAMPING = 2.0**-20
"""Smallest fraction of a Newton step; below it the iteration fails."""


@dataclass(frozen=True)
class StaticState:
    """Static equilibrium at a pose.

    Attributes:
        elastic: elastic coordinates q_e (n,) [m, rad].
        position: end effector (2,) [m].
        torque: motor torques that hold the pose (2,) [N m].
    """

    elastic: RealArray
    position: RealArray
    torque: RealArray


def static_equilibrium(scene: Scene, joints: tuple[float, float] | RealArray) -> StaticState:
    """Equilibrium with the motors locked at the angles (q11, q21) [rad].

    Raises:
        EquilibriumError: the iteration doesn't converge; the message gives pose and residual.
    """
    model, u = numeric_model(scene), standstill(joints)
    elastic = _newton(model, u)
    zeros = np.zeros(model.n)
    position, _, _, torque = model.motion(elastic, zeros, zeros, u)
    return StaticState(elastic, np.asarray(position.full()).ravel(), np.asarray(torque.full()).ravel())


def _newton(model: NumericModel, u: RealArray) -> RealArray:
    """Elastic coordinates (n,) in equilibrium, by damped Newton iteration on the elastic forces at rest."""
    q = np.zeros(model.n)
    if model.n == 0:
        return q
    # iterate until a full step is at rounding, or no fraction of it reduces the residual
    force = _static_force(model, q, u)
    for _ in range(MAXIMUM_ITERATIONS):
        step = np.linalg.solve(model.static_stiffness(q, u).full(), -force)
        q, force, damping = _damped_step(model, u, q, step, force)
        if damping == 1.0 and np.linalg.norm(step) <= RELATIVE_STEP * np.linalg.norm(q):
            return q
        if damping < SMALLEST_DAMPING or not np.all(np.isfinite(q)):
            break
        if np.linalg.norm(step) < np.finfo(float).eps * np.linalg.norm(q) or not np.any(force):
            return q
    # a residual at the rounding level of the cancelling forces counts as zero
    if _at_rounding(model, u, q, force):
        return q
    raise EquilibriumError(
        f"no static equilibrium with the motors at q11 = {u[0]:.6g} rad, q21 = {u[1]:.6g} rad: the residual force stays at "
        f"{np.linalg.norm(force):.3g} N; the pose may be too near to a singularity or the links too soft for the load"
    )


def _damped_step(
    model: NumericModel, u: RealArray, q: RealArray, step: RealArray, force: RealArray
) -> tuple[RealArray, RealArray, float]:
    """New coordinates, force and damping; halves the step until the residual falls or is at rounding level."""
    # halve the step until it is accepted
    damping, norm = 1.0, np.linalg.norm(force)
    while damping >= SMALLEST_DAMPING:
        trial = q + damping * step
        trial_force = _static_force(model, trial, u)
        if np.all(np.isfinite(trial_force)) and (
            np.linalg.norm(trial_force) < norm or _at_rounding(model, u, trial, trial_force)
        ):
            return trial, trial_force, damping
        damping *= 0.5
    return q, force, 0.0


def _at_rounding(model: NumericModel, u: RealArray, q: RealArray, force: RealArray) -> bool:
    """Whether the residual is only rounding of the elastic forces that cancel in it."""
    stiffness = np.abs(model.static_stiffness(q, u).full())
    load = np.abs(_static_force(model, np.zeros(model.n), u))
    scale = stiffness @ np.abs(q) + load
    return bool(np.all(np.abs(force) <= 1e3 * np.finfo(float).eps * scale + np.finfo(float).tiny))


def _static_force(model: NumericModel, q: RealArray, u: RealArray) -> RealArray:
    zeros = np.zeros(model.n)
    return np.asarray(model.elastic_forces(q, zeros, zeros, u).full()).ravel()
