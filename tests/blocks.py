"""Blocks of single sections of a scene file, without a loop: `pd(50.0, 2.0, sample_time=1e-3)`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import casadi
import control as control_library
import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu import control, disturbances, filters, imperfections
from flexfmu.cosim.control.controllers.from_control import LinearSystem, from_control
from flexfmu.cosim.control.sections import LoopContext, block_of
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicBlock

SHARED = ("name", "connect", "signal", "start", "duration", "sample_time", "offset", "frequency_at", "pose")
"""Keys that many sections have, which are given by name."""


class Context(LoopContext):
    """A context with a place for every pose."""

    def position(self, pose: str) -> tuple[float, float]:
        return (0.0, 0.32)


@cache
def robot() -> Scene:
    """The paper's robot."""
    return load_scene("barnard2012-6kg")


def looped(controller: Mapping[str, Any], *imperfections: Mapping[str, Any], **changes: Any) -> Scene:
    """The paper's robot with one bending and one axial mode, driven by a loop; changes are of its effects."""
    effects = {"motor_inertia": 0.1, "proximal_bending": 1, "distal_axial": 1, **changes}
    keys = {"cosimulation.drive": "torque", "cosimulation.tolerance": 1e-8, "trajectory.dwell": 0.0}
    keys |= {f"effects.{key}": value for key, value in effects.items()}
    return robot().replace({**keys, "controller": [controller], "imperfection": list(imperfections)})


def context(
    name: str, initial: Sequence[float] = (), scene: Scene | None = None, path: Any = None, **others: Any
) -> Context:
    """The context of a section: its values before the first sample, its robot, and its planned motion."""
    keys: dict[str, Any] = {"joints": path, "shaped": path, "period": None, "sample_time": 1e-3} | others
    return Context(scene or robot(), path, name=name, before=lambda kind: initial, **keys)


def maker(part: Callable[..., Any]) -> Callable[..., Any]:
    """The function that makes the block of a part: values of its own keys in their order, then keys, and what a context has."""
    own = [key for key in inspect.signature(part).parameters if key not in SHARED]

    def make(*values: Any, **keys: Any) -> Any:
        of_context = {key: keys.pop(key) for key in ("initial", "scene", "path", "period", "shaped") if key in keys}
        section = part(**dict(zip(own, values, strict=False)), **keys)
        return block_of(section, context(section.name or section.kind.replace("-", "_"), **of_context))

    return make


pd, pid, computed_torque = maker(control.pd), maker(control.pid), maker(control.computed_torque)
cascade, learning, lqg, h_infinity = map(maker, (control.cascade, control.learning, control.lqg, control.h_infinity))
feedforward, gravity_feedforward = maker(control.feedforward), maker(control.gravity_feedforward)
friction_compensation = maker(control.friction_compensation)
disturbance_observer = maker(control.disturbance_observer)
c_function, state_space = maker(control.c_function), maker(control.state_space)
saturation, rate_limit = maker(imperfections.saturation), maker(imperfections.rate_limit)
dead_zone, backlash = maker(imperfections.dead_zone), maker(imperfections.backlash)
quantisation, encoder = maker(imperfections.quantisation), maker(imperfections.encoder)
noise, jitter = maker(imperfections.noise), maker(imperfections.jitter)
delay, lag = maker(imperfections.delay), maker(imperfections.lag)
notch, low_pass, high_pass = map(maker, (filters.notch, filters.low_pass, filters.high_pass))
lead_lag, biquad = maker(filters.lead_lag), maker(filters.biquad)
step, pulse, sine = map(maker, (disturbances.step, disturbances.pulse, disturbances.sine))
band_noise, table, payload = map(maker, (disturbances.noise, disturbances.csv, disturbances.payload))


def linear_system(A: Any, B: Any, C: Any, D: Any, sample_time: float) -> LinearSystem:
    """A discrete system of matrices, with signals ``u[0]``, .. and ``y[0]``, .."""
    return from_control(control_library.ss(A, B, C, D, sample_time))


def sampled(
    block: SymbolicBlock, inputs: ArrayLike, parameters: Mapping[str, float] | None = None
) -> NDArray[np.float64]:
    """Outputs (N, outputs) of a block for inputs (N, inputs), or (N,) for all of them, at its sample instants, from its start on."""
    u = np.asarray(inputs, dtype=float)
    u = np.tile(u[:, None], len(block.inputs)) if u.ndim == 1 else u
    changes = dict(parameters or {})
    p = [changes.pop(each.name, each.start) for each in block.parameters]
    assert not changes, f"no such parameters: {changes}"
    if not block.states:
        return np.array(block.output.map(len(u))([], u.T, p)).T
    x, inp, par = (casadi.MX.sym(key, block.output.sparsity_in(i)) for i, key in enumerate("xup"))
    step = casadi.Function("step", [x, inp, par], [block.update(x, inp, par), block.output(x, inp, par)])
    _, y = step.mapaccum(len(u))(casadi.DM(block.states), u.T, casadi.DM(p))
    return np.array(y).T


def responses(block: SymbolicBlock, given: Mapping[str, ArrayLike]) -> dict[str, NDArray[np.float64]]:
    """Output → (N,) values for input or parameter → (N,) values; inputs left out keep their start value."""
    values = {name: np.asarray(each, dtype=float) for name, each in given.items()}
    assert not values.keys() - {each.name for each in (*block.inputs, *block.parameters)}
    count = len(next(iter(values.values())))
    inputs = [values.get(each.name, np.full(count, each.start)) for each in block.inputs]
    parameters = {each.name: values[each.name][0] for each in block.parameters if each.name in values}
    return dict(
        zip((each.name for each in block.outputs), sampled(block, np.column_stack(inputs), parameters).T, strict=True)
    )
