"""Linear-quadratic regulator with a Kalman filter (LQG) for the torque-driven robot, designed at a pose.

The gains solve the discrete algebraic Riccati equations of the sampled, linearised robot and of its dual: G. F.
Franklin, J. D. Powell, M. L. Workman, Digital Control of Dynamic Systems, 3rd ed. 1998, sections 9.3 and 9.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexfmu.cosim.control.controllers.from_control import from_control
from flexfmu.cosim.control.controllers.joints import Limits, torque_limits
from flexfmu.cosim.control.controllers.linear_system import LinearSystem
from flexfmu.cosim.control.controllers.state_feedback import (
    Equilibrium,
    InputLimits,
    state_feedback,
    static_feedforward,
)
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.model.linear import linearize, operating_point, without_coulomb_friction
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.controllers import StateFeedbackSection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicBlock
from flexfmu.trajectories.along_path import positions_along

POSITIONS = ("joint1.position", "joint2.position")
RATES = ("joint1.velocity", "joint2.velocity")
TORQUES = ("joint1.torque", "joint2.torque")


@dataclass(frozen=True)
class LqgWeights:
    """Deviations that cost one unit each (Bryson's rule), and the noise that the filter is designed for.

    Attributes:
        position_error: of each joint [rad].
        velocity_error: of each joint [rad/s].
        torque_deviation: of each motor, from its torque at the equilibrium [N.m].
        torque_noise: standard deviation of a white disturbance torque [N.m].
        measurement_noise: standard deviation of the measured angles [rad].
    """

    position_error: tuple[float, float] = (1e-3, 1e-3)
    velocity_error: tuple[float, float] = (0.1, 0.1)
    torque_deviation: tuple[float, float] = (10.0, 10.0)
    torque_noise: float = 1.0
    measurement_noise: float = 1e-5


@one_blas_thread()
def lqg(
    scene: Scene,
    position: tuple[float, float],
    weights: LqgWeights | None = None,
    *,
    sample_time: float,
    offset: float = 0.0,
    limits: Limits | None = None,
    name: str = "state_feedback",
) -> SymbolicBlock:
    """Build the block: state feedback with a full-order observer, from measured angles alone.

    The robot is linearised about its equilibrium at a pose, without Coulomb friction, and discretised with a zero-order hold of
    the torques; `control.dlqr` and `control.dlqe` calculate the gains. Constant references are tracked without static error in
    the linearised robot.

    Args:
        scene: the robot.
        position: end-effector position of the rigid robot at the pose (2,) [m].
        weights: of cost and noise; `LqgWeights()` when left out.
        sample_time, offset: [s].
        limits: torque limits; None for none.
        name: name of the block.

    Raises:
        InputError: python-control is missing.
        EquilibriumError: there is no equilibrium at the pose.
    """
    scene = without_coulomb_friction(scene)
    # the plant: the linearised robot with zero-order hold; the cost needs the rates too
    robot = linearize(scene, position, (*POSITIONS, *RATES))[:, :2]
    units = dict.fromkeys(TORQUES, "N.m") | dict.fromkeys(POSITIONS, "rad") | dict.fromkeys(RATES, "rad/s")
    full = from_control(
        robot, method="zoh", sample_time=sample_time, inputs=TORQUES, outputs=(*POSITIONS, *RATES), units=units
    )
    K, L = _gains(full, weights or LqgWeights())
    # the observer measures positions alone
    measured_units = {name: unit for name, unit in units.items() if name not in RATES}
    measured = from_control(
        robot[:2, :], method="zoh", sample_time=sample_time, inputs=TORQUES, outputs=POSITIONS, units=measured_units
    )
    # feedforward of the steady state that belongs to each reference, about the equilibrium
    point = operating_point(scene, position)
    rest = Equilibrium(inputs=point.inputs[:2].tolist(), outputs=point.coordinates[:2].tolist())
    reference = static_feedforward(measured, POSITIONS, rest)
    start = np.asarray(motor_angles(scene.mechanism, scene.start)) - point.coordinates[:2]
    bounds = None
    if limits is not None:
        lower, upper = (np.broadcast_to(np.asarray(each, dtype=float), 2) for each in (limits.lower, limits.upper))
        bounds = InputLimits(lower.tolist(), upper.tolist())
    return state_feedback(
        measured,
        K,
        L,
        offset=offset,
        reference=reference,
        equilibrium=rest,
        estimate=(reference.Nx @ start).tolist(),
        limits=bounds,
        name=name,
    )


def _gains(robot: LinearSystem, weights: LqgWeights) -> tuple[RealArray, RealArray]:
    """Return feedback gains K and observer gains L for a robot whose outputs are angles, then rates.

    Raises:
        InputError: python-control is missing.
    """
    try:
        import control
    except ImportError:
        raise InputError("state feedback needs python-control; run: pip install flexfmu[control]") from None
    # the regulator, by Bryson's rule: each deviation relative to its unit of cost
    cost = robot.C.T @ np.diag(1.0 / np.square([*weights.position_error, *weights.velocity_error])) @ robot.C
    K, _, _ = control.dlqr(robot.A, robot.B, cost, np.diag(1.0 / np.square(weights.torque_deviation)))
    # the filter, from measured angles alone
    noise = weights.torque_noise**2 * np.eye(2), weights.measurement_noise**2 * np.eye(2)
    L, _, _ = control.dlqe(robot.A, robot.B, robot.C[: len(POSITIONS)], *noise)
    return K, L


@builds(StateFeedbackSection)
def _from_section(section: StateFeedbackSection, context: LoopContext) -> SymbolicBlock:
    weights = LqgWeights(
        section.position_error,
        section.velocity_error,
        section.torque_deviation,
        section.torque_noise,
        section.measurement_noise,
    )
    # end-effector position at the design pose
    x, y = positions_along(context.along_path, {"start": 0.0, "middle": 0.5, "end": 1.0}[section.pose])[0].tolist()
    return lqg(
        context.scene,
        (x, y),
        weights,
        limits=torque_limits(section.torque_limit),
        sample_time=section.sample_time,
        offset=section.offset,
    )
