"""Static equilibrium of the flexible robot with locked motors, and its natural frequencies and damping about it.

The equilibrium is found by Newton's method with step halving. The stiffness matrix is exact, so convergence is quadratic. Near the
solution the elastic forces of stiff families cancel to rounding; a step then needn't reduce the residual.

Small motions satisfy M x'' + C x' + K x = 0. Squared undamped frequencies [rad²/s²] are the generalised eigenvalues of
(K, M); damped modes are eigenvalues of the first-order form in [x, x'].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi
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
    elastic, zeros = _newton(model, u), np.zeros(model.n)
    position, _, _, torque = model.motion(elastic, zeros, zeros, u)
    return StaticState(elastic, np.asarray(position.full()).ravel(), np.asarray(torque.full()).ravel())


def _newton(model: NumericModel, u: RealArray) -> RealArray:
    """Elastic coordinates (n,) in equilibrium, by damped Newton iteration on the elastic forces at rest."""
    q = zeros = np.zeros(model.n)
    if model.n == 0:
        return q

    def force_at(q: RealArray) -> RealArray:
        return np.asarray(model.elastic_forces(q, zeros, zeros, u).full()).ravel()

    def at_rounding(q: RealArray, force: RealArray) -> bool:
        """Whether the residual is only rounding of the elastic forces that cancel in it."""
        scale = np.abs(model.static_stiffness(q, u).full()) @ np.abs(q) + np.abs(force_at(zeros))
        return bool(np.all(np.abs(force) <= 1e3 * np.finfo(float).eps * scale + np.finfo(float).tiny))

    # iterate until a full step is at rounding, or no fraction of it reduces the residual
    force = force_at(q)
    for _ in range(MAXIMUM_ITERATIONS):
        step = np.linalg.solve(model.static_stiffness(q, u).full(), -force)
        # halve the step until the residual falls or is at rounding level
        damping, norm = 1.0, np.linalg.norm(force)
        while damping >= SMALLEST_DAMPING:
            trial = q + damping * step
            found = force_at(trial)
            if np.all(np.isfinite(found)) and (np.linalg.norm(found) < norm or at_rounding(trial, found)):
                q, force = trial, found
                break
            damping *= 0.5
        if damping == 1.0 and np.linalg.norm(step) <= RELATIVE_STEP * np.linalg.norm(q):
            return q
        if damping < SMALLEST_DAMPING or not np.all(np.isfinite(q)):
            break
        if np.linalg.norm(step) < np.finfo(float).eps * np.linalg.norm(q) or not np.any(force):
            return q
    # a residual at the rounding level of the cancelling forces counts as zero
    if at_rounding(q, force):
        return q
    raise EquilibriumError(
        f"no static equilibrium with the motors at q11 = {u[0]:.6g} rad, q21 = {u[1]:.6g} rad: the residual force stays at "
        f"{np.linalg.norm(force):.3g} N; the pose may be too near to a singularity or the links too soft for the load"
    )


OSCILLATING = 1e-9
"""An eigenvalue belongs to a vibration if its imaginary part exceeds this fraction of its magnitude."""


@dataclass(frozen=True, eq=False)
class DampedModes:
    """Damped modes of the assembled robot, in ascending order of frequency, without overdamped modes.

    Attributes:
        frequencies: |λ| / 2π of the eigenvalues λ [Hz], shape (m,): the undamped natural frequency where the damping is
            proportional.
        ratios: damping ratios -Re λ / |λ|, shape (m,).
    """

    frequencies: RealArray
    ratios: RealArray


def natural_frequencies(scene: Scene, joints: tuple[float, float] | RealArray) -> RealArray:
    """Undamped natural frequencies [Hz], ascending, shape (n,), with the motors locked at (q11, q21) [rad].

    Raises:
        EquilibriumError: there is no static equilibrium at the pose, or it is unstable (buckled).
    """
    if numeric_model(scene).n == 0:
        return np.empty(0)
    mass, _, stiffness = _matrices(scene, joints)
    from scipy.linalg import eigh  # here, since building a model needs no scipy

    return np.asarray(np.sqrt(_stable(eigh(stiffness, mass, eigvals_only=True), joints)) / (2 * np.pi), dtype=float)


def damped_modes(scene: Scene, joints: tuple[float, float] | RealArray) -> DampedModes:
    """Frequencies and damping ratios with the motors locked at (q11, q21) [rad]: eigenvalues of M x'' + C x' + K x = 0.

    Raises:
        EquilibriumError: there is no static equilibrium at the pose, or it is unstable (buckled).
    """
    n = numeric_model(scene).n
    if n == 0:
        return DampedModes(np.empty(0), np.empty(0))
    # first-order form in [x, x'] about a stable equilibrium
    mass, damping, stiffness = _matrices(scene, joints)
    from scipy.linalg import eigh

    _stable(eigh(stiffness, mass, eigvals_only=True), joints)
    acceleration = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
    values = np.linalg.eigvals(np.vstack([np.eye(n, 2 * n, n), acceleration])).astype(complex)
    # one eigenvalue of each conjugate pair, ascending; overdamped modes have none
    values = values[values.imag > OSCILLATING * np.abs(values)]
    values = values[np.argsort(np.abs(values))]
    size = np.abs(values)
    # the real part of an undamped mode is a rounding error of either sign
    return DampedModes(size / (2 * np.pi), np.maximum(-values.real / size, 0.0))


def _matrices(scene: Scene, joints: tuple[float, float] | RealArray) -> tuple[RealArray, RealArray, RealArray]:
    """Mass, damping and stiffness of small motions about the static equilibrium, (n, n) each."""
    model, u = numeric_model(scene), standstill(joints)
    elastic = static_equilibrium(scene, joints).elastic
    stiffness, mass = model.static_stiffness(elastic, u).full(), model.mass_matrix(elastic, u).full()
    return 0.5 * (mass + mass.T), _damping_matrix(scene)(elastic, u).full(), 0.5 * (stiffness + stiffness.T)


@lru_cache(maxsize=32)
def _damping_matrix(scene: Scene) -> casadi.Function:
    """(q_e, u) → damping matrix: Jacobian of the elastic forces by the elastic rates at rest (n, n) [N s/m]."""
    model = numeric_model(scene)
    q, v, u = casadi.SX.sym("q", model.n), casadi.SX.sym("v", model.n), casadi.SX.sym("u", 6)
    force = model.elastic_forces(q, v, casadi.SX.zeros(model.n), u)
    at_rest = casadi.substitute(casadi.jacobian(force, v), v, casadi.SX.zeros(model.n))
    return casadi.Function("damping_matrix", [q, u], [casadi.densify(casadi.cse(at_rest))])


def _stable(squares: RealArray, joints: tuple[float, float] | RealArray) -> RealArray:
    """The squared angular frequencies, ascending; raises `EquilibriumError` if one is negative."""
    if squares[0] < 0.0:
        raise EquilibriumError(
            f"the static equilibrium with the motors at q11 = {joints[0]:.6g} rad, q21 = {joints[1]:.6g} rad is unstable "
            f"(lowest eigenvalue {squares[0]:.4g} 1/s2): the load buckles the robot near this pose"
        )
    return squares
