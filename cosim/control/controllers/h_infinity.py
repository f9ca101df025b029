"""H-infinity loop shaping for the torque-driven robot (D. McFarlane, K. Glover, IEEE Trans. Automatic Control 37, 1992, 759-769).

The robot is linearised about its equilibrium at a pose, without Coulomb friction, and sampled with a zero-order hold. Weights shape it:
each joint gets
W = k (1 + 1 / (T s)) with the gain k for which the joint's own loop crosses 1 at its bandwidth. The controller K then stabilises the
shaped plant G W with the largest margin epsilon against perturbations of its normalised coprime factors; epsilon = 1 / gamma, where
gamma is the H-infinity norm of [I; K] (I - G W K)^-1 [I, G W]. Formulas for a plant with feedthrough: S. Skogestad,
I. Postlethwaite, Multivariable Feedback Control, 2nd ed. 2005, section 9.4.2.

The design is made in the w plane, w = 2/h (z - 1)/(z + 1), and transformed back, which keeps stability and H-infinity norms: both hold for
the sampled loop, not for an approximation of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt
from typing import TYPE_CHECKING

import casadi
import numpy as np
from scipy.linalg import solve_continuous_are

from flexfmu.cosim.control.blocks.equations import Vector
from flexfmu.cosim.control.controllers.from_control import times
from flexfmu.cosim.control.controllers.joints import TORQUE, joint_block, limited
from flexfmu.cosim.control.controllers.state_feedback import POSITIONS
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.model.linear import linearize, operating_point, without_coulomb_friction
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.controllers import HInfinitySection
from flexfmu.model.symbolic import SymbolicBlock

if TYPE_CHECKING:
    import control

SUBOPTIMAL = 1.1
"""Ratio of gamma to its smallest value: at the smallest one the controller's equations are singular."""

INTEGRAL = 5.0
"""Integral time, relative to 1 / bandwidth in rad/s, where none is given."""


def to_w(system: control.StateSpace, sample_time: float) -> control.StateSpace:
    """Return a discrete system as one of w = 2/h (z - 1)/(z + 1); Tustin's rule is the inverse."""
    import control

    one, rate = np.eye(len(system.A)), 2.0 / sample_time
    inverse, factor = np.linalg.inv(one + system.A), sqrt(2.0 * rate)
    B, C, D = factor * inverse @ system.B, factor * system.C @ inverse, system.D - system.C @ inverse @ system.B
    return control.ss(rate * inverse @ (system.A - one), B, C, D)


def to_z(system: control.StateSpace, sample_time: float) -> control.StateSpace:
    """Return a system of w as a discrete one; the inverse of `to_w`, so B and C share the factor."""
    import control

    sampled, root = system.sample(sample_time, "tustin"), sqrt(sample_time)
    return control.ss(sampled.A, sampled.B / root, sampled.C * root, sampled.D, sample_time)


def coprime_controller(plant: control.StateSpace, suboptimal: float = SUBOPTIMAL) -> tuple[control.StateSpace, float]:
    """Return the controller that is most robust against perturbations of the plant's normalised coprime factors, and gamma.

    Args:
        plant: continuous, stabilisable and detectable.
        suboptimal: ratio of gamma to its smallest value, above 1.

    Returns:
        K for positive feedback, u = K y, of the plant's order; gamma, the H-infinity norm of [I; K] (I - G K)^-1 [I, G], which is
        at most this, and at least sqrt(1 + rho(X Z)).

    Raises:
        InputError: the Riccati equations have no solution.
    """
    import control

    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    S, R = np.eye(B.shape[1]) + D.T @ D, np.eye(C.shape[0]) + D @ D.T
    shifted = A - B @ np.linalg.solve(S, D.T @ C)
    try:
        X = solve_continuous_are(shifted, B, C.T @ np.linalg.solve(R, C), S)
        Z = solve_continuous_are(shifted.T, C.T, B @ np.linalg.solve(S, B.T), R)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise InputError(f"H-infinity loop shaping has no solution for this plant: {error}") from error
    gamma = suboptimal * sqrt(1.0 + float(np.abs(np.linalg.eigvals(X @ Z)).max()))
    # the central controller
    F = -np.linalg.solve(S, D.T @ C + B.T @ X)
    scaled = np.linalg.solve(((1.0 - gamma**2) * np.eye(len(A)) + X @ Z).T, gamma**2 * Z @ C.T)
    gain = np.asarray(scaled, dtype=np.float64)
    return control.ss(A + B @ F + gain @ (C + D @ F), gain, B.T @ X, -D.T), gamma


@dataclass(frozen=True, eq=False)
class ShapedLoop:
    """A design: weights, controller and how robust they are.

    Attributes:
        weights: W, discrete, joint by joint.
        controller: K, discrete, for positive feedback of the deviation from the reference.
        margin: epsilon = 1 / gamma; above 0.25 the shape of the loop is compatible with robustness.
    """

    weights: control.StateSpace
    controller: control.StateSpace
    margin: float


def shape_loop(
    plant: control.StateSpace, sample_time: float, bandwidth: RealArray, integral_time: RealArray
) -> ShapedLoop:
    """Design weights and controller of a sampled plant with as many inputs as outputs.

    Args:
        plant: discrete.
        sample_time: h [s].
        bandwidth: (n,) frequencies at which each input's own loop crosses 1 before the controller [rad/s], below pi / h.
        integral_time: (n,) T [s].

    Raises:
        InputError: the Riccati equations have no solution, or the loop isn't stable.
    """
    import control

    # in the w plane, with the unit of time 1 / bandwidth, which keeps the Riccati equations well scaled
    scale = float(bandwidth.max())
    h = scale * sample_time
    robot = to_w(plant, h)
    crossing = 2.0 / h * np.tan(bandwidth * sample_time / 2.0)
    corner = 1.0 / (scale * integral_time)
    gains = [
        1.0 / abs(robot(1j * w)[i, i] * (1.0 + c / (1j * w)))
        for i, (w, c) in enumerate(zip(crossing, corner, strict=True))
    ]
    n = len(gains)
    weights = control.ss(np.zeros((n, n)), np.diag(corner), np.diag(gains), np.diag(gains))
    controller, gamma = coprime_controller(robot * weights)
    found = ShapedLoop(to_z(weights, h), to_z(controller, h), 1.0 / gamma)
    radius = float(np.abs(np.linalg.eigvals(closed_loop(plant, found))).max())
    if not radius < 1.0:
        raise InputError(
            f"H-infinity loop shaping: the sampled loop isn't stable (largest eigenvalue {radius:.6g}); give a lower bandwidth"
        )
    return found


def closed_loop(plant: control.StateSpace, loop: ShapedLoop) -> RealArray:
    """Return the matrix of the loop of a discrete plant without feedthrough, its references at rest."""
    whole = loop.weights * loop.controller
    return np.block([[plant.A + plant.B @ whole.D @ plant.C, plant.B @ whole.C], [whole.B @ plant.C, whole.A]])


@builds(HInfinitySection)
@one_blas_thread()
def h_infinity(s: HInfinitySection, context: LoopContext) -> SymbolicBlock:
    """Build the block: torque = sat(u_0 + W(z) K(z) (q - q_r) + feedforward), from measured angles alone.

    At the limits the weights get what the motors give (R. Hanus, M. Kinnaert, J.-L. Henrotte, Automatica 23, 1987, 729-739), so that
    their integrals don't wind up. Inputs: ``joint1.reference.position``, ``joint1.position``, ``joint1.feedforward`` (zero unless
    connected); output ``joint1.torque``.

    Raises:
        InputError: the bandwidth isn't below half the sampling frequency, or there is no stable loop.
        EquilibriumError: there is no equilibrium at the pose.
    """
    frequency, h, position = np.array(s.bandwidth, dtype=float), s.sample_time, context.position(s.pose)
    if (frequency >= 0.5 / h).any():
        raise InputError(
            f"h_infinity: bandwidth must be below half the sampling frequency, {0.5 / h:g} Hz, got {frequency.max():g} Hz"
        )
    rate = 2.0 * pi * frequency
    integral_time = INTEGRAL / rate if s.integral_time is None else np.array(s.integral_time, dtype=float)
    scene = without_coulomb_friction(context.scene)
    plant = linearize(scene, position, POSITIONS)[:, :2].sample(h)
    loop = shape_loop(plant, h, rate, integral_time)
    return shaped_block(s, loop, operating_point(scene, position).inputs[:2])


def shaped_block(s: HInfinitySection, loop: ShapedLoop, holding: RealArray) -> SymbolicBlock:
    """Build the block of a design; ``holding`` are the torques u_0 at the equilibrium [N.m]."""
    W, K, u_0 = loop.weights, loop.controller, np.asarray(holding, dtype=float)
    order, size = len(K.A), len(K.A) + len(u_0)

    def law(x: Vector, signals: list[Vector], bounds: list[Vector]) -> tuple[Vector, Vector]:
        inside, outside = x[:order], x[order:]
        reference, angle, feedforward = signals
        # controller, then weights
        deviation = angle - reference
        shaped = times(K.C, inside) + times(K.D, deviation)
        wanted = u_0 + feedforward + times(W.C, outside) + times(W.D, shaped)
        torque = limited(wanted, bounds)
        # the weights get the input that would have given this torque
        inverse = np.asarray(np.linalg.inv(W.D), dtype=np.float64)
        applied = shaped + times(inverse, torque - wanted) if bounds else shaped
        updated = times(K.A, inside) + times(K.B, deviation), times(W.A, outside) + times(W.B, applied)
        return torque, casadi.vertcat(*updated)

    what, takes = f"H-infinity loop shaping of order {size}", ("reference.position", "position", "feedforward")
    return joint_block(
        "h_infinity", what, law, takes, TORQUE, {}, limit=s.torque_limit, states=[0.0] * size, **s.sampling
    )
