"""Gain scheduling: gains of a controller that follow a signal, such as the pose or the payload.

Each scheduled gain is the controller's own times a factor, piecewise linear over the signal and constant beyond its breakpoints (K. J. Åström,
B. Wittenmark, Adaptive Control, 2nd ed. 1995, chapter 9). The factor is that of the sample; an integral keeps what it has summed with the
gains of the past.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.controllers.joints import PerJoint, per_joint, saturate
from flexfmu.cosim.control.controllers.named_signals import unit_of
from flexfmu.cosim.control.sections import LoopContext
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.controllers import ScheduleSection
from flexfmu.model.symbolic import SymbolicBlock, Variable

PAYLOAD = "payload.mass"
"""Signal of the payload; where no slave outputs it, it is that of the scene."""


def scheduled(
    controller: SymbolicBlock,
    over: str,
    at: Sequence[float],
    factors: Mapping[str, Sequence[PerJoint]],
    *,
    start: float = 0.0,
) -> SymbolicBlock:
    """Return the controller with factors on its gains that follow a signal, which becomes an input unless it is one already.

    Args:
        controller: a block with gains among its parameters, ``joint1.proportional_gain`` and so on.
        over: name of the signal.
        at: two or more ascending values of the signal, in its unit.
        factors: last part of a gain's name, ``proportional_gain`` → a factor at each of these values, or one for each joint.
        start: value of the signal until it is connected.

    Raises:
        InputError: the values don't ascend, the signal is the controller's output, the controller has no such gain, or factors are
            missing, negative or not finite.
    """
    points = np.asarray(at, dtype=float)
    if points.ndim != 1 or points.size < 2 or not np.isfinite(points).all() or (np.diff(points) <= 0.0).any():
        raise InputError(f"{controller.name}: a schedule needs two or more ascending values of {over}, got {list(at)}")
    if over in (each.name for each in controller.outputs):
        raise InputError(
            f"{controller.name}: its gains can't follow its own output {over}: let `over` be a measured signal, or a reference"
        )
    # factors (points,) of every parameter that has some
    tables: dict[int, np.ndarray] = {}
    for gain, rows in factors.items():
        places = [i for i, each in enumerate(controller.parameters) if each.name.endswith(f".{gain}")]
        if not places:
            gains = dict.fromkeys(each.name.rpartition(".")[2] for each in controller.parameters)
            raise InputError(f"{controller.name} has no gain {gain!r} to schedule; it has {', '.join(gains)}")
        if len(rows) != points.size:
            raise InputError(
                f"{controller.name}: {gain} needs a factor at each of {points.size} values, got {len(rows)}"
            )
        joints = [controller.parameters[i].name.removesuffix(f".{gain}") for i in places]
        values = np.array([per_joint(joints, f"the factor on {gain}", row, "1", minimum=0.0) for row in rows])
        tables |= dict(zip(places, values.T, strict=True))
    names = [each.name for each in controller.inputs]
    is_new = over not in names

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        signal = u[len(names) if is_new else names.index(over)]
        parts = casadi.vertsplit(p)
        for i, table in tables.items():
            parts[i] = parts[i] * _interpolated(signal, points, table)
        arguments = [x, u[: len(names)], casadi.vertcat(*parts)]
        return controller.output.call(arguments)[0], controller.update.call(arguments)[0]

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


def with_schedule(
    controller: SymbolicBlock,
    schedule: ScheduleSection | None,
    context: LoopContext,
    proportional: str = "proportional_gain",
) -> SymbolicBlock:
    """Return the controller with the schedule of its section, if there is one.

    Args:
        controller: the controller.
        schedule: the schedule, whose keys name gains.
        context: has the payload that controllers assume.
        proportional: what the controller calls its proportional gain.
    """
    if schedule is None:
        return controller
    names = {"proportional": proportional, "integral": "integral_gain", "derivative": "derivative_gain"}
    factors = {names.get(key, key): table for key, table in schedule.factors.items()}
    start = context.scene.payload.mass if schedule.over == PAYLOAD else 0.0
    return scheduled(controller, schedule.over, schedule.at, factors, start=start)
