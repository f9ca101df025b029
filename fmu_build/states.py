"""The continuous states of a plant, x = [y, dy/dt], and the outputs with the same values.

In the model description each state is a local variable, an alias of its output. FMI allows an output that is itself a state,
but Maestro 3.1.1 fails where a state and its derivative are both connected outputs (ClassCastException in
ComponentVariableFmi2Api.share), and controllers usually take position and velocity.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, sqrt
from typing import TYPE_CHECKING, TypeVar

import casadi

from flexfmu.fmu_build.errors import ModelError

if TYPE_CHECKING:
    from flexfmu.model.symbolic import SymbolicModel

T = TypeVar("T")

USUAL_MOTION = 10.0
"""Usual size of a motion in the error norm, relative to the norm's floor; the five-bar's floor corresponds to an
acceleration of 1 m/s² or a motor rate of 0.1 rad/s."""

USUAL_ANGLE = 1.0
"""Usual size of a motor's coordinate [rad]; the error norm gives none, since the origin is arbitrary."""


@dataclass(frozen=True)
class States:
    """Outputs and nominal values of the 2 n states y, dy/dt.

    Attributes:
        outputs: index of the output that equals each state, from 0.
        derivatives: index of the output that equals each state's time derivative, in the same order.
        nominals: nominal value of each state in its unit, positive.
    """

    outputs: tuple[int, ...]
    derivatives: tuple[int, ...]
    nominals: tuple[float, ...]


def state_name(output: str) -> str:
    """Name of the state that equals an output: ``state.joint1.position``, ``der(state.link11.bending[1])``."""
    head, name = ("der(", output.removeprefix("der(")) if output.startswith("der(") else ("", output)
    return f"{head}state.{name}"


def find_states(model: SymbolicModel) -> States:
    """Find the states of ``model`` among its outputs, by the names of the unknowns and by ``derivative_of``.

    Raises:
        ModelError: a state or its derivative is not an output.
    """
    position: dict[str | None, int] = {variable.name: index for index, variable in enumerate(model.outputs)}
    derivative = {variable.derivative_of: variable.name for variable in model.outputs}
    # coordinates, velocities, accelerations
    levels = [list(model.unknowns)]
    for _ in range(2):
        levels.append([_shown(derivative, name, "time derivative of") for name in levels[-1]])
    y, v, a = ([_shown(position, name, "state") for name in names] for names in levels)
    return States((*y, *v), (*v, *a), _nominals(model))


def state_dependencies(model: SymbolicModel) -> tuple[tuple[int, ...], ...]:
    """For each output the indices 0 .. 2 n - 1 of the states that it depends on; all if it depends on accelerations."""
    outputs, n = model.functions["outputs"], model.degrees_of_freedom
    y, v, a = (_rows(outputs.jac_sparsity(0, argument)) if n else {} for argument in range(3))
    everything = tuple(range(2 * n))
    return tuple(
        everything if row in a else (*sorted(y.get(row, ())), *(n + k for k in sorted(v.get(row, ()))))
        for row in range(len(model.outputs))
    )


def _rows(sparsity: casadi.Sparsity) -> dict[int, set[int]]:
    """Row → columns of its structural nonzeros; empty rows are left out."""
    rows: dict[int, set[int]] = {}
    for row, column in zip(*sparsity.get_triplet(), strict=True):
        rows.setdefault(row, set()).add(column)
    return rows


def _shown(table: Mapping[str | None, T], name: str, what: str) -> T:
    if name not in table:
        raise ModelError(f"no output shows the {what} '{name}', which model exchange needs")
    return table[name]


def _nominals(model: SymbolicModel) -> tuple[float, ...]:
    """Nominal values of the states, two digits, from the error norm sqrt(sum kappa_i dy_i² + mu_i dv_i²)."""
    n = model.degrees_of_freedom
    # weights of the error norm at the start values
    derived = model.functions["derive"]([variable.start or 0.0 for variable in model.parameters])
    *weights, floor = model.functions["error_scale"](derived).full().ravel().tolist()
    sizes = [USUAL_MOTION * floor / sqrt(weight) if weight > 0.0 else 1.0 for weight in weights]
    sizes[: model.locked] = [USUAL_ANGLE] * model.locked
    return tuple(float(f"{size:.2g}") if isfinite(size) and size > 0.0 else 1.0 for size in sizes[: 2 * n])
