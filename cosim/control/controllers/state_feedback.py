"""State feedback with a prediction observer, reference feedforward and input limits; and its design for the torque-driven robot.

The linear-quadratic regulator with a Kalman filter (LQG) is designed at a pose. Its gains solve the discrete algebraic Riccati
equations of the sampled, linearised robot and of its dual: G. F. Franklin, J. D. Powell, M. L. Workman, Digital Control of Dynamic
Systems, 3rd ed. 1998, sections 9.3 and 9.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.controllers.from_control import LinearSystem, from_control, matrix, times
from flexfmu.cosim.control.controllers.joints import PerJoint, limited
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.model.linear import linearize, operating_point, without_coulomb_friction
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.controllers import StateFeedbackSection
from flexfmu.model.symbolic import SymbolicBlock, Variable


@dataclass(frozen=True, eq=False)
class ReferenceFeedforward:
    """Target states and inputs of references r: x_r = Nx r, u_r = Nu r.

    Attributes:
        signals: the references, inputs of the controller.
        Nx: (n, references).
        Nu: (plant inputs, references).
        base: value of each reference at the equilibrium, (references,); r is the deviation from it.
    """

    signals: tuple[Variable, ...]
    Nx: RealArray
    Nu: RealArray
    base: Sequence[float] = ()


@dataclass(frozen=True)
class Equilibrium:
    """Operating point of a linearised plant: inputs u_0 and outputs y_0, in the order of its signals."""

    inputs: Sequence[float]
    outputs: Sequence[float]


def state_feedback(
    plant: LinearSystem,
    K: Any,
    L: Any,
    *,
    offset: float = 0.0,
    reference: ReferenceFeedforward | None = None,
    equilibrium: Equilibrium | None = None,
    limits: PerJoint | None = None,
    estimate: Sequence[float] | None = None,
    name: str = "state_feedback",
) -> SymbolicBlock:
    """Build the block u = sat(u_0 + Nu r - K (x̂ - Nx r)), with the prediction observer ::

        x̂_k+1 = A x̂_k + B (u_k - u_0) + L (y_k - y_0 - C x̂_k - D (u_k - u_0))

    The estimation error has the poles of A - L C, the plant those of A - B K (separation). The observer uses the
    saturated input, so the estimate stays right at the limits; no other anti-windup is needed. G. F. Franklin,
    J. D. Powell, M. L. Workman, Digital Control of Dynamic Systems, 3rd ed. 1998, sections 8.2 to 8.4; K. J. Åström,
    B. Wittenmark, Computer-Controlled Systems, 3rd ed. 1997, section 8.5. K comes from `control.dlqr`, L from
    `control.dlqe`.

    Its inputs are the plant's outputs and the references, its outputs the plant's inputs, under the same names. Only
    the references have direct feedthrough, the measurements have none.

    Args:
        plant: model of the plant for deviations from the equilibrium, at the controller's sample time.
        K: (plant inputs, n) feedback gains.
        L: (n, plant outputs) observer gains.
        offset: first sample instant [s].
        reference: reference feedforward, for example `static_feedforward`; None regulates to the equilibrium.
        equilibrium: u_0 and y_0; zero when left out.
        limits: largest magnitude of the plant's inputs, not of their deviations from the equilibrium: one number, or one for each
            input; None for none.
        estimate: x̂_0 (n,); zero when left out.
        name: name of the block.

    Raises:
        InputError: a gain has the wrong shape or isn't finite, a vector has the wrong length, or a limit isn't positive.
    """
    # check every matrix and vector against the plant
    n, m, outputs = plant.order, len(plant.inputs), len(plant.outputs)
    K, L = matrix(K, (m, n), f"{name}: K"), matrix(L, (n, outputs), f"{name}: L")
    given = reference or ReferenceFeedforward((), np.zeros((n, 0)), np.zeros((m, 0)))
    count = len(given.signals)
    Nx, Nu = matrix(given.Nx, (n, count), f"{name}: Nx"), matrix(given.Nu, (m, count), f"{name}: Nu")
    base = _values(given.base or None, count, f"{name}: base of the references")
    u_0 = _values(equilibrium.inputs if equilibrium else None, m, f"{name}: equilibrium.inputs")
    y_0 = _values(equilibrium.outputs if equilibrium else None, outputs, f"{name}: equilibrium.outputs")
    bounds = []
    if limits is not None:
        largest = np.broadcast_to(np.asarray(limits, dtype=float), m)
        if not ((largest > 0.0) & (largest < np.inf)).all():
            raise InputError(f"{name}: limits must be positive and finite, got {limits}")
        bounds = [-largest, largest]

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # deviations of measurements and references from the equilibrium
        deviation, target = u[:outputs, 0] - y_0, u[outputs:, 0] - np.reshape(base, (-1, 1))
        # feedback and feedforward, within the limits
        applied = limited(u_0 + times(Nu, target) - times(K, x - times(Nx, target)), bounds)
        # the observer sees the limited input
        effect = applied - u_0
        innovation = deviation - times(plant.C, x) - times(plant.D, effect)
        return applied, times(plant.A, x) + times(plant.B, effect) + times(L, innovation)

    # inputs: measurements, then references; states: the estimate
    return block(
        name,
        f"State feedback from an observer of order {n}",
        equations,
        sample_time=plant.sample_time,
        offset=offset,
        inputs=[replace(each, causality="input", start=0.0) for each in (*plant.outputs, *given.signals)],
        outputs=[replace(each, causality="output", start=None) for each in plant.inputs],
        states=_values(estimate, n, f"{name}: estimate").tolist(),
    )


def static_feedforward(
    plant: LinearSystem, tracked: Sequence[str], equilibrium: Equilibrium | None = None
) -> ReferenceFeedforward:
    """Return the feedforward for zero static error of the tracked outputs ::

        [A - I  B] [Nx]   [0]
        [C      D] [Nu] = [I]

    (Franklin, Powell, Workman, section 8.4.2.) The reference of ``joint1.position`` is ``joint1.reference.position``.

    Args:
        plant: model of the plant.
        tracked: names of as many outputs as the plant has inputs.
        equilibrium: as for `state_feedback`.

    Raises:
        InputError: a name is unknown, their number isn't that of the inputs, or the outputs can't be set
            independently at rest.
    """
    names = [signal.name for signal in plant.outputs]
    for name in tracked:
        if name not in names:
            raise InputError(f"static feedforward: the plant has no output {name!r}; choose from {', '.join(names)}")
    if len(tracked) != len(plant.inputs):
        raise InputError(
            f"static feedforward: {len(plant.inputs)} inputs can track as many outputs, got {len(tracked)}"
        )
    # steady state: 0 = (A - I) x + B u and r = C x + D u, solved for x and u of a unit r
    rows = [names.index(name) for name in tracked]
    n, count = plant.order, len(rows)
    system = np.block([[plant.A - np.eye(n), plant.B], [plant.C[rows], plant.D[rows]]])
    if np.linalg.matrix_rank(system) < n + count:
        raise InputError(f"static feedforward: {', '.join(tracked)} can't be set independently at rest by the inputs")
    solution = np.linalg.solve(system, np.eye(n + count)[:, n:])
    signals = tuple(replace(plant.outputs[row], name=reference_name(names[row])) for row in rows)
    base = [equilibrium.outputs[row] for row in rows] if equilibrium else []
    return ReferenceFeedforward(signals, solution[:n], solution[n:], base)


def reference_name(name: str) -> str:
    """Return the reference's name: ``joint1.position`` → ``joint1.reference.position``, ``y`` → ``reference.y``."""
    place, dot, kind = name.rpartition(".")
    return f"{place}{dot}reference.{kind}"


def _values(values: Sequence[float] | None, count: int, what: str) -> RealArray:
    """Return (count,) finite numbers; zeros for None."""
    if values is None:
        return np.zeros(count)
    array = np.asarray(values, dtype=float)
    return matrix(array.reshape(-1, 1), (count, 1), what)[:, 0]


POSITIONS = ("joint1.position", "joint2.position")
RATES = ("joint1.velocity", "joint2.velocity")


@builds(StateFeedbackSection)
@one_blas_thread()
def lqg(s: StateFeedbackSection, context: LoopContext) -> SymbolicBlock:
    """Build the block: state feedback with a full-order observer, from measured angles alone.

    The robot is linearised about its equilibrium at a pose, without Coulomb friction, and discretised with a zero-order hold of
    the torques; `control.dlqr` and `control.dlqe` calculate the gains. Deviations cost one unit each (Bryson's rule). Constant
    references are tracked without static error in the linearised robot.

    Raises:
        EquilibriumError: there is no equilibrium at the pose.
    """
    import control

    scene, position = without_coulomb_friction(context.scene), context.position(s.pose)
    # the plant: the linearised robot with zero-order hold; the cost needs the rates too
    robot = linearize(scene, position, (*POSITIONS, *RATES))[:, :2].sample(s.sample_time)
    cost = robot.C.T @ np.diag(1.0 / np.square([*s.position_error, *s.velocity_error])) @ robot.C
    K, _, _ = control.dlqr(robot.A, robot.B, cost, np.diag(1.0 / np.square(s.torque_deviation)))
    # the observer measures positions alone
    noise = s.torque_noise**2 * np.eye(2), s.measurement_noise**2 * np.eye(2)
    L, _, _ = control.dlqe(robot.A, robot.B, robot.C[: len(POSITIONS)], *noise)
    measured = from_control(robot[:2, :])
    # feedforward of the steady state that belongs to each reference, about the equilibrium
    point = operating_point(scene, position)
    rest = Equilibrium(inputs=point.inputs[:2].tolist(), outputs=point.coordinates[:2].tolist())
    reference = static_feedforward(measured, POSITIONS, rest)
    start = np.asarray(motor_angles(scene.mechanism, scene.start)) - point.coordinates[:2]
    estimate = (reference.Nx @ start).tolist()
    return state_feedback(
        measured, K, L, offset=s.offset, reference=reference, equilibrium=rest, limits=s.torque_limit, estimate=estimate
    )
