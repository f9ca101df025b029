"""The continuous states of a plant, x = [y, dy/dt], as its outputs show them.

In the description each state is a local variable of its own, an alias of the output that shows it. An output that is a state
itself would be right too, but Maestro 3.1.1 stops where a state and its derivative are outputs and both are connected
(ClassCastException in ComponentVariableFmi2Api.share), as position and velocity are to any controller.
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
"""Usual size of a motion in the error norm, relative to that norm's floor: the five-bar's floor is what an acceleration of
1 m/s² or a motor rate of 0.1 rad/s makes of it."""

USUAL_ANGLE = 1.0
"""Usual size of a motor's coordinate [rad]: its origin is arbitrary, so the error norm says nothing about it."""


@dataclass(frozen=True)
class States:
    """Positions among the model's outputs and usual sizes of the 2 n states y, dy/dt.

    Attributes:
        outputs: the output that shows each state.
        derivatives: the output that shows each state's time derivative, in the same order.
        nominals: usual size of each state in its unit, positive.
    """

    outputs: tuple[int, ...]
    derivatives: tuple[int, ...]
    nominals: tuple[float, ...]


def state_name(output: str) -> str:
    """Name of the state that an output shows: ``state.joint1.position``, ``der(state.link11.bending[1])``."""
    head, name = ("der(", output.removeprefix("der(")) if output.startswith("der(") else ("", output)
    return f"{head}state.{name}"


def find_states(model: SymbolicModel) -> States:
    """The states of ``model`` among its outputs: those named like the unknowns, and their derivatives.

    Raises:
        ModelError: a state or its derivative isn't shown by an output.
    """
    position: dict[str | None, int] = {variable.name: index for index, variable in enumerate(model.outputs)}
    derivative = {variable.derivative_of: variable.name for variable in model.outputs}
    # coordinates, their rates, the rates of these
    levels = [list(model.unknowns)]
    for _ in range(2):
        levels.append([_shown(derivative, name, "time derivative of") for name in levels[-1]])
    y, v, a = ([_shown(position, name, "state") for name in names] for names in levels)
    return States((*y, *v), (*v, *a), _nominals(model))


def state_dependencies(model: SymbolicModel) -> tuple[tuple[int, ...], ...]:
    """For each output the states (positions 0 .. 2 n - 1) that it depends on; accelerations follow from all of them."""
    outputs, n = model.functions["outputs"], model.degrees_of_freedom
    y, v, a = (_rows(outputs.jac_sparsity(0, argument)) if n else {} for argument in range(3))
    everything = tuple(range(2 * n))
    return tuple(
        everything if row in a else (*sorted(y.get(row, ())), *(n + k for k in sorted(v.get(row, ()))))
        for row in range(len(model.outputs))
    )


def _rows(sparsity: casadi.Sparsity) -> dict[int, set[int]]:
    """Columns of the entries in each row that has any."""
    rows: dict[int, set[int]] = {}
    for row, column in zip(*sparsity.get_triplet(), strict=True):
        rows.setdefault(row, set()).add(column)
    return rows


def _shown(table: Mapping[str | None, T], name: str, what: str) -> T:
    if name not in table:
        raise ModelError(f"no output shows the {what} '{name}', which model exchange needs")
    return table[name]


def _nominals(model: SymbolicModel) -> tuple[float, ...]:
    """Sizes of the states in a usual motion, two digits: the error norm is sqrt(sum kappa_i dy_i² + mu_i dv_i²)."""
    n = model.degrees_of_freedom
    # weights of the error norm at the start values
    derived = model.functions["derive"]([variable.start or 0.0 for variable in model.parameters])
    *weights, floor = model.functions["error_scale"](derived).full().ravel().tolist()
    sizes = [USUAL_MOTION * floor / sqrt(weight) if weight > 0.0 else 1.0 for weight in weights]
    sizes[: model.locked] = [USUAL_ANGLE] * model.locked
    return tuple(float(f"{size:.2g}") if isfinite(size) and size > 0.0 else 1.0 for size in sizes[: 2 * n])
