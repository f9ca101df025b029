"""The motion-driven robot as a differential equation, compiled, for solvers that aren't ours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.blocks.code import compile_function
from flexfmu.cosim.workprec.motion_polynomials import DEGREE
from flexfmu.model.modes import natural_frequencies
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
    """dz/dt = f(t, z) with z = [q_e, dq_e/dt / pace]: solvers have one absolute tolerance for both.

    Attributes:
        n: number of elastic coordinates.
        rate: (t, z, piece) → dz/dt (2 n,), compiled together with its Jacobian, which CasADi's solvers find there.
        jacobian: (t, z, piece, dz/dt, which may be left out) → the parts of that Jacobian by t, z and piece; those by t and
            piece are empty, as nothing needs them.
        position: (t, z, piece) → end-effector position (2,) [m].
        start: z at the beginning (2 n,).
    """

    n: int
    rate: casadi.Function
    jacobian: casadi.Function
    position: casadi.Function
    start: Array

    def bound(self, piece: Array) -> BoundFunction:
        """The rate on one piece."""
        return BoundFunction(self.rate, piece)

    def bound_jacobian(self, piece: Array) -> Callable[[float, Array], Array]:
        """(t, z) → exact Jacobian of the rate (2 n, 2 n) on one piece."""
        flat, shape = BoundFunction(self.jacobian, piece, output=1), (2 * self.n, 2 * self.n)
        return lambda t, z: flat(t, z).reshape(shape, order="F")


@lru_cache(maxsize=4)
def equations(scene: Scene, joints: tuple[float, float]) -> Equations:
    """The equations of a scene, that starts at these joint angles [rad]."""
    model, pace = numeric_model(scene), _pace(scene, joints)
    n, t = model.n, casadi.SX.sym("t")
    z, piece, a = casadi.SX.sym("z", 2 * n), casadi.SX.sym("piece", NUMBERS), casadi.SX.sym("a", n)
    u = joint_motion(t, piece)
    q, v = z[:n], pace * z[n:]
    mass = model.mass_matrix(q, u)
    acceleration = casadi.solve(mass, -model.elastic_forces(q, v, casadi.SX.zeros(n), u))
    rate = casadi.Function("rate", [t, z, piece], [casadi.densify(casadi.cse(casadi.vertcat(v, acceleration / pace)))])

    # M a + b = 0 holds for all z, so that M da/dz = -d(M a + b)/dz with a held
    change = casadi.substitute(casadi.jacobian(model.elastic_forces(q, v, a, u), z), a, acceleration)
    rows = casadi.vertcat(casadi.jacobian(v, z), -casadi.solve(mass, casadi.densify(change)) / pace)
    by_z, unused = casadi.densify(casadi.cse(rows)), casadi.SX.sym("dz", 2 * n)
    by_all = [casadi.SX(2 * n, 1), by_z, casadi.SX(2 * n, NUMBERS)]
    jacobian = casadi.Function("jac_rate", [t, z, piece, unused], by_all)

    compiled = compile_function(rate, jacobian)
    position = casadi.densify(model.motion(q, v, acceleration, u)[0])
    return Equations(
        n=n,
        rate=compiled,
        jacobian=compiled.jacobian(),
        position=compile_function(casadi.Function("position", [t, z, piece], [casadi.cse(position)])),
        start=_start(scene, joints, n),
    )


def _pace(scene: Scene, joints: tuple[float, float]) -> float:
    """First natural frequency [rad/s] at the start, by which rates are larger than coordinates."""
    frequencies = natural_frequencies(scene, joints)
    return float(2.0 * np.pi * frequencies[0]) if frequencies.size else 1.0


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
    """A function (t, z, piece) → (count,) on buffers of its own, for one piece, without conversions on the way.

    A matrix comes column by column; with several outputs one is chosen.
    """

    def __init__(self, function: casadi.Function, piece: Array, output: int = 0) -> None:
        self._time, self._state, self._piece = np.zeros(1), np.zeros(function.numel_in(1)), piece.copy()
        self._result = np.zeros(function.numel_out(output))
        self._function = function
        buffer: Any
        buffer, self._evaluate = function.buffer()
        self._kept = buffer  # the call needs it
        for i, values in enumerate((self._time, self._state, self._piece)):
            buffer.set_arg(i, values.data)
        buffer.set_res(output, self._result.data)

    def __call__(self, t: float, z: Array) -> Array:
        self._time[0] = t
        self._state[:] = z
        self._evaluate()
        return self._result.copy()
