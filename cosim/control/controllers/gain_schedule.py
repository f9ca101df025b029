"""Gain scheduling: gains of a controller that follow a signal, such as the pose or the payload.

Each scheduled gain is the controller's own times a factor, piecewise linear over the signal and constant beyond its breakpoints (K. J. Åström,
B. Wittenmark, Adaptive Control, 2nd ed. 1995, chapter 9). The factor is that of the sample; an integral keeps what it has summed with the
gains of the past.
"""

from __future__ import annotations

from itertools import pairwise

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.controllers.joints import saturate, unit_of
from flexfmu.cosim.control.sections import LoopContext
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.controllers import ScheduleSection
from flexfmu.model.symbolic import SymbolicBlock, Variable

PAYLOAD = "payload.mass"
"""Signal of the payload; where no slave outputs it, it is that of the scene."""


def with_schedule(
    controller: SymbolicBlock,
    schedule: ScheduleSection | None,
    context: LoopContext,
    proportional: str = "proportional_gain",
) -> SymbolicBlock:
    """Return the controller with factors on its gains that follow a signal, which becomes an input unless it is one already.

    Args:
        controller: the controller.
        schedule: the schedule, whose keys name gains; None for the controller as it is.
        context: has the payload that controllers assume.
        proportional: what the controller calls its proportional gain.

    Raises:
        InputError: the signal is the controller's output.
    """
    if schedule is None:
        return controller
    over, points = schedule.over, np.array(schedule.at, dtype=float)
    if over in (each.name for each in controller.outputs):
        raise InputError(
            f"{controller.name}: its gains can't follow its own output {over}: let `over` be a measured signal, or a reference"
        )
    # factors (points,) of every parameter that has some
    gains = {"proportional": proportional, "integral": "integral_gain", "derivative": "derivative_gain"}
    tables: dict[int, np.ndarray] = {}
    for key, rows in schedule.factors.items():
        places = [i for i, p in enumerate(controller.parameters) if p.name.endswith(f".{gains.get(key, key)}")]
        tables |= dict(zip(places, np.array(rows).T, strict=True))
    names = [each.name for each in controller.inputs]
    is_new = over not in names

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        signal = u[len(names) if is_new else names.index(over)]
        parts = casadi.vertsplit(p)
        for i, table in tables.items():
            parts[i] = parts[i] * _interpolated(signal, points, table)
        arguments = [x, u[: len(names)], casadi.vertcat(*parts)]
        return controller.output.call(arguments)[0], controller.update.call(arguments)[0]

    start = context.scene.payload.mass if over == PAYLOAD else 0.0
    signal = [Variable(over, unit_of(over), "Signal that gains follow", "input", start)] if is_new else []
    return block(
        controller.name,
        f"{controller.description}, gains over {over}",
        equations,
        sample_time=controller.sample_time,
        offset=controller.offset,
        inputs=[*controller.inputs, *signal],
        outputs=controller.outputs,
        parameters=controller.parameters,
        states=controller.states,
        symbol=casadi.SX if controller.output.is_a("SXFunction") else casadi.MX,
        latency=controller.latency,
    )


def _interpolated(signal: Vector, at: np.ndarray, values: np.ndarray) -> Vector:
    """Return the piecewise linear function of the signal, constant beyond its ends; NaN stays NaN."""
    result = values[0]
    for (left, right), rise in zip(pairwise(at.tolist()), np.diff(values).tolist(), strict=True):
        result = result + rise * (saturate(signal, left, right) - left) / (right - left)
    return result
