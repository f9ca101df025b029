"""State feedback with a prediction observer, reference feedforward and input limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.controllers.joints import saturate
from flexfmu.cosim.control.controllers.linear_system import LinearSystem, Signal, matrix, times, variables
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.model.symbolic import SymbolicBlock


@dataclass(frozen=True, eq=False)
class ReferenceFeedforward:
    """Target states and inputs of references r: x_r = Nx r, u_r = Nu r.

    Attributes:
        signals: the references, which are inputs of the controller.
        Nx: (n, references).
        Nu: (plant inputs, references).
        base: value of each reference at the equilibrium, (references,); r is the deviation from it.
    """

    signals: tuple[Signal, ...]
    Nx: RealArray
    Nu: RealArray
    base: Sequence[float] = ()


@dataclass(frozen=True)
class Equilibrium:
    """Operating point of a linearised plant: inputs u_0 and outputs y_0, in the order of its signals."""

    inputs: Sequence[float]
    outputs: Sequence[float]


@dataclass(frozen=True)
class InputLimits:
    """Lower and upper limit of each plant input, as absolute values, not deviations from the equilibrium."""

    lower: Sequence[float]
    upper: Sequence[float]


@dataclass(frozen=True, eq=False)
class StateFeedbackLaw:
    """u = sat(u_0 + Nu r - K (x̂ - Nx r)), with the prediction observer ::

        x̂_k+1 = A x̂_k + B (u_k - u_0) + L (y_k - y_0 - C x̂_k - D (u_k - u_0))

    The estimation error has the poles of A - L C, the plant those of A - B K (separation). The observer uses the
    saturated input, so the estimate stays right at the limits; no other anti-windup is needed. G. F. Franklin,
    J. D. Powell, M. L. Workman, Digital Control of Dynamic Systems, 3rd ed. 1998, sections 8.2 to 8.4; K. J. Åström,
    B. Wittenmark, Computer-Controlled Systems, 3rd ed. 1997, section 8.5. K comes from `control.dlqr`, L from
    `control.dlqe`.

    Attributes:
        plant: A, B, C, D.
        K: (plant inputs, n) feedback gains.
        L: (n, plant outputs) observer gains.
        reference: Nx, Nu and the references r.
        u_0, y_0: inputs and outputs at the equilibrium.
        bounds: lower and upper limits of the inputs, (plant inputs,) each; None for none.
    """

    plant: LinearSystem
    K: RealArray
    L: RealArray
    reference: ReferenceFeedforward
    u_0: RealArray
    y_0: RealArray
    bounds: tuple[RealArray, RealArray] | None

    def equations(self, x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return plant inputs and next estimate from the estimate x, u = [y, r] and no parameters."""
        # deviations of measurements and references from the equilibrium
        plant, r, outputs = self.plant, self.reference, len(self.plant.outputs)
        deviation, target = u[:outputs, 0] - self.y_0, u[outputs:, 0] - np.reshape(r.base, (-1, 1))
        # feedback and feedforward, within the limits
        wanted = self.u_0 + times(r.Nu, target) - times(self.K, x - times(r.Nx, target))
        applied = saturate(wanted, *self.bounds) if self.bounds else wanted
        # the observer sees the limited input
        effect = applied - self.u_0
        innovation = deviation - times(plant.C, x) - times(plant.D, effect)
        return applied, times(plant.A, x) + times(plant.B, effect) + times(self.L, innovation)


def state_feedback(
    plant: LinearSystem,
    K: Any,
    L: Any,
    *,
    offset: float = 0.0,
    reference: ReferenceFeedforward | None = None,
    equilibrium: Equilibrium | None = None,
    limits: InputLimits | None = None,
    estimate: Sequence[float] | None = None,
    name: str = "state_feedback",
) -> SymbolicBlock:
    """Build the block of `StateFeedbackLaw`.

    Its inputs are the plant's outputs and the references, its outputs the plant's inputs, under the same names. Only
    the references have direct feedthrough, the measurements have none.

    Args:
        plant: model of the plant for deviations from the equilibrium, at the controller's sample time.
        K: (plant inputs, n) feedback gains.
        L: (n, plant outputs) observer gains.
        offset: first sample instant [s].
        reference: reference feedforward, for example `static_feedforward`; None regulates to the equilibrium.
        equilibrium: u_0 and y_0; zero when left out.
        limits: limits of the plant's inputs; None for none.
        estimate: x̂_0 (n,); zero when left out.
        name: name of the block.

    Raises:
        InputError: a gain has the wrong shape or isn't finite, a vector has the wrong length, or limits are in the
            wrong order.
    """
    # check every matrix and vector against the plant
    n, m, outputs = plant.order, len(plant.inputs), len(plant.outputs)
    r = _checked(reference, plant, name)
    law = StateFeedbackLaw(
        plant,
        matrix(K, (m, n), f"{name}: K"),
        matrix(L, (n, outputs), f"{name}: L"),
        r,
        _values(equilibrium.inputs if equilibrium else None, m, f"{name}: equilibrium.inputs"),
        _values(equilibrium.outputs if equilibrium else None, outputs, f"{name}: equilibrium.outputs"),
        _bounds(limits, m, name),
    )
    # inputs: measurements, then references; states: the estimate
    return block(
        name,
        f"State feedback from an observer of order {n}",
        law.equations,
        sample_time=plant.sample_time,
        offset=offset,
        inputs=variables((*plant.outputs, *r.signals), "input"),
        outputs=variables(plant.inputs, "output"),
        states=np.asarray(_values(estimate, n, f"{name}: estimate")).ravel().tolist(),
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
    # input signals of the references
    signals = tuple(Signal(reference_name(names[row]), plant.outputs[row].unit) for row in rows)
    base = [equilibrium.outputs[row] for row in rows] if equilibrium else []
    return ReferenceFeedforward(signals, solution[:n], solution[n:], base)


def reference_name(name: str) -> str:
    """Return the reference's name: ``joint1.position`` → ``joint1.reference.position``, ``y`` → ``reference.y``."""
    place, dot, kind = name.rpartition(".")
    return f"{place}{dot}reference.{kind}"


def _checked(reference: ReferenceFeedforward | None, plant: LinearSystem, name: str) -> ReferenceFeedforward:
    """Return the feedforward with checked matrices; one without references for None."""
    given = reference or ReferenceFeedforward((), np.zeros((plant.order, 0)), np.zeros((len(plant.inputs), 0)))
    count = len(given.signals)
    return ReferenceFeedforward(
        given.signals,
        matrix(given.Nx, (plant.order, count), f"{name}: Nx"),
        matrix(given.Nu, (len(plant.inputs), count), f"{name}: Nu"),
        [float(value) for value in np.asarray(_values(given.base or None, count, f"{name}: base of the references"))],
    )


def _values(values: Sequence[float] | None, count: int, what: str) -> RealArray:
    """Return (count,) finite numbers; zeros for None."""
    if values is None:
        return np.zeros(count)
    array = np.asarray(values, dtype=float)
    return matrix(array.reshape(-1, 1), (count, 1), what)[:, 0]


def _bounds(limits: InputLimits | None, count: int, name: str) -> tuple[RealArray, RealArray] | None:
    """Return lower and upper limits, each (count,); None for none."""
    if limits is None:
        return None
    lower = _values(limits.lower, count, f"{name}: limits.lower")
    upper = _values(limits.upper, count, f"{name}: limits.upper")
    if not (lower < upper).all():
        raise InputError(f"{name}: every lower limit must be below its upper one, got {lower} and {upper}")
    return lower, upper
