"""The motion-driven robot as a differential equation, compiled, for solvers that aren't ours."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.blocks.code import compile_function
from flexfmu.cosim.workprec.motion_polynomials import DEGREE
from flexfmu.model.numeric import numeric_model
from flexfmu.model.scene import Scene
from flexfmu.model.statics import static_equilibrium

Array = NDArray[np.float64]
Symbol = Any
"""casadi.SX or casadi.MX."""

NUMBERS = 2 + 3 * (DEGREE + 1) * 2
"""Length of `Piece.numbers`."""


@dataclass(frozen=True)
class Equations:
    """dz/dt = f(t, z) with z = [q_e, dq_e/dt].

    Attributes:
        n: number of elastic coordinates.
        rate: (t, z, piece) → dz/dt (2 n,).
        rate_expression: the same as a CasADi function that isn't compiled, for solvers that want its derivatives.
        position: (t, z, piece) → end-effector position (2,) [m].
        start: z at the beginning (2 n,).
    """

    n: int
    rate: casadi.Function
    rate_expression: casadi.Function
    position: casadi.Function
    start: Array


@lru_cache(maxsize=4)
def equations(scene: Scene, joints: tuple[float, float]) -> Equations:
    """The equations of a scene, that starts at these joint angles [rad]."""
    model = numeric_model(scene)
    n, t = model.n, casadi.SX.sym("t")
    z, piece = casadi.SX.sym("z", 2 * n), casadi.SX.sym("piece", NUMBERS)
    u = joint_motion(t, piece)
    q, v = z[:n], z[n:]
    acceleration = casadi.solve(model.mass_matrix(q, u), -model.elastic_forces(q, v, casadi.SX.zeros(n), u))
    rate = casadi.Function("rate", [t, z, piece], [casadi.densify(casadi.cse(casadi.vertcat(v, acceleration)))])
    position = casadi.densify(model.motion(q, v, acceleration, u)[0])
    return Equations(
        n=n,
        rate=compile_function(rate),
        rate_expression=rate,
        position=compile_function(casadi.Function("position", [t, z, piece], [casadi.cse(position)])),
        start=_start(scene, joints, n),
    )


def _start(scene: Scene, joints: tuple[float, float], n: int) -> Array:
    is_static = scene.cosimulation.initial == "static"
    elastic = static_equilibrium(scene, np.array(joints)).elastic if is_static else np.zeros(n)
    return np.concatenate([elastic, np.zeros(n)])


def joint_motion(t: Symbol, piece: Symbol) -> Symbol:
    """u = [q_a, v_a, a_a] (6, 1) at a time of a piece, by Clenshaw's recurrence."""
    begin, end = piece[0], piece[1]
    x = (2.0 * t - begin - end) / (end - begin)
    coefficients = casadi.reshape(piece[2:], 3, (DEGREE + 1) * 2)
    rows = []
    for derivative in range(3):
        for joint in range(2):
            series = [coefficients[derivative, k + joint * (DEGREE + 1)] for k in range(DEGREE + 1)]
            rows.append(_clenshaw(x, series))
    return casadi.vertcat(*rows)


def _clenshaw(x: Symbol, series: list[Symbol]) -> Symbol:
    last = before = 0.0 * x
    for coefficient in series[:0:-1]:
        last, before = coefficient + 2.0 * x * last - before, last
    return series[0] + x * last - before


class BoundFunction:
    """A function (t, z, piece) → (count,) on buffers of its own, for one piece, without conversions on the way."""

    def __init__(self, function: casadi.Function, piece: Array) -> None:
        self._time, self._state, self._piece = np.zeros(1), np.zeros(function.numel_in(1)), piece.copy()
        self._result = np.zeros(function.numel_out(0))
        self._function = function
        buffer: Any
        buffer, self._evaluate = function.buffer()
        self._kept = buffer  # the call needs it
        for i, values in enumerate((self._time, self._state, self._piece)):
            buffer.set_arg(i, values.data)
        buffer.set_res(0, self._result.data)

    def __call__(self, t: float, z: Array) -> Array:
        self._time[0] = t
        self._state[:] = z
        self._evaluate()
        return self._result.copy()
