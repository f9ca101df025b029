"""The motion-driven robot as an initial value problem, compiled, for solvers of other libraries.

Solvers evaluate the equations at one instant at a time. The planned joint motion is therefore interpolated by Chebyshev polynomials
between its breakpoints, which the equations evaluate by Clenshaw's recurrence (Clenshaw, Math. Comp. 9, 1955).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import casadi
import numpy as np
from numpy.polynomial import chebyshev

from flexfmu.cosim.control.blocks.code import compile_function
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.model.numeric import numeric_model
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import natural_frequencies, static_equilibrium
from flexfmu.trajectories.trajectory import Trajectory

DEGREE = 95
"""Degree of every polynomial, so high that motions of the shipped scenes need only one piece between two breakpoints: multistep
solvers restart at each piece."""

ACCURACY = 1e-13
"""Largest error of an angle relative to its range; pieces are halved until they keep it."""

SMALLEST = 2.0**-12
"""Shortest piece, as a fraction of the interval between two breakpoints."""


@dataclass(frozen=True)
class MotionPolynomial:
    """Joint angles over an interval of time.

    Attributes:
        begin, end: [s].
        coefficients: (3, DEGREE + 1, 2) Chebyshev coefficients of angles [rad], rates and accelerations on [-1, 1].
    """

    begin: float
    end: float
    coefficients: RealArray

    @property
    def numbers(self) -> RealArray:
        """begin, end and all coefficients in one vector, the last index running slowest."""
        return np.concatenate([[self.begin, self.end], self.coefficients.ravel(order="F")])


def motion_polynomials(motion: Trajectory, stop: float) -> tuple[MotionPolynomial, ...]:
    """Polynomials that follow a joint motion, and its standstill afterwards, up to ``stop`` [s]."""
    points = [*motion.breakpoints, *([stop] if stop > motion.duration else [])]
    return tuple(piece for begin, end in pairwise(points) for piece in _split(motion, begin, end, end - begin))


def _split(motion: Trajectory, begin: float, end: float, whole: float) -> Iterator[MotionPolynomial]:
    piece, error = _fit(motion, begin, end)
    if error <= ACCURACY or end - begin <= SMALLEST * whole:
        yield piece
        return
    middle = 0.5 * (begin + end)
    yield from _split(motion, begin, middle, whole)
    yield from _split(motion, middle, end, whole)


def _fit(motion: Trajectory, begin: float, end: float) -> tuple[MotionPolynomial, float]:
    """Interpolation in Chebyshev's points, and its error in between."""
    # nodes for the interpolation, and points in between for its error
    half, centre = 0.5 * (end - begin), 0.5 * (begin + end)
    nodes = chebyshev.chebpts1(DEGREE + 1)
    between = np.cos(np.linspace(0.0, np.pi, 3 * DEGREE))[1:-1]
    values = motion.evaluate(centre + half * np.concatenate([nodes, between]), 2)
    series = np.stack([chebyshev.chebfit(nodes, each[: DEGREE + 1], DEGREE) for each in values])
    error = np.abs(chebyshev.chebval(between, series[0]).T - values[0, DEGREE + 1 :]).max()
    return MotionPolynomial(begin, end, series), float(error / max(1.0, np.ptp(values[0])))


Symbol = Any
"""casadi.SX or casadi.MX."""

NUMBERS = 2 + 3 * (DEGREE + 1) * 2
"""Length of `MotionPolynomial.numbers`."""


@dataclass(frozen=True)
class InitialValueProblem:
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
    start: RealArray

    def bound_jacobian(self, piece: RealArray) -> Callable[[float, RealArray], RealArray]:
        """(t, z) → exact Jacobian of the rate (2 n, 2 n) on one piece."""
        flat, shape = BoundFunction(self.jacobian, piece, output=1), (2 * self.n, 2 * self.n)
        return lambda t, z: flat(t, z).reshape(shape, order="F")


@lru_cache(maxsize=4)
def equations(scene: Scene, joints: tuple[float, float]) -> InitialValueProblem:
    """The equations of a scene, that starts at these joint angles [rad]."""
    # rates are larger than coordinates by the first natural frequency [rad/s] at the start
    frequencies = natural_frequencies(scene, joints)
    pace = float(2.0 * np.pi * frequencies[0]) if frequencies.size else 1.0
    model = numeric_model(scene)
    n, t = model.n, casadi.SX.sym("t")
    z, piece, a = casadi.SX.sym("z", 2 * n), casadi.SX.sym("piece", NUMBERS), casadi.SX.sym("a", n)
    # the rate
    u = joint_motion(t, piece)
    q, v = z[:n], pace * z[n:]
    mass = model.mass_matrix(q, u)
    acceleration = casadi.solve(mass, -model.elastic_forces(q, v, casadi.SX.zeros(n), u))
    rate = casadi.Function("rate", [t, z, piece], [casadi.densify(casadi.cse(casadi.vertcat(v, acceleration / pace)))])

    # M a + b = 0 holds for all z, so that M da/dz = -d(M a + b)/dz at constant a
    change = casadi.substitute(casadi.jacobian(model.elastic_forces(q, v, a, u), z), a, acceleration)
    rows = casadi.vertcat(casadi.jacobian(v, z), -casadi.solve(mass, casadi.densify(change)) / pace)
    by_z, unused = casadi.densify(casadi.cse(rows)), casadi.SX.sym("dz", 2 * n)
    by_all = [casadi.SX(2 * n, 1), by_z, casadi.SX(2 * n, NUMBERS)]
    jacobian = casadi.Function("jac_rate", [t, z, piece, unused], by_all)

    # compiled with its Jacobian
    compiled = compile_function(rate, jacobian)
    position = casadi.densify(model.motion(q, v, acceleration, u)[0])
    return InitialValueProblem(
        n=n,
        rate=compiled,
        jacobian=compiled.jacobian(),
        position=compile_function(casadi.Function("position", [t, z, piece], [casadi.cse(position)])),
        start=start_state(scene, np.array(joints), n),
    )


def start_state(scene: Scene, joints: RealArray, n: int) -> RealArray:
    """[q_e, dq_e/dt] at the start (2 n,) for joint angles (2,) [rad]: at rest, in static equilibrium or undeformed as the scene says."""
    is_static = scene.cosimulation.initial == "static"
    elastic = static_equilibrium(scene, joints).elastic if is_static else np.zeros(n)
    return np.concatenate([elastic, np.zeros(n)])


def joint_motion(t: Symbol, piece: Symbol) -> Symbol:
    """u = [q_a, v_a, a_a] (6, 1) at a time of a piece, by Clenshaw's recurrence."""
    begin, end = piece[0], piece[1]
    # time on [-1, 1]
    x = (2.0 * t - begin - end) / (end - begin)
    coefficients = casadi.reshape(piece[2:], 3, (DEGREE + 1) * 2)
    rows = []
    for derivative in range(3):
        for joint in range(2):
            series = [coefficients[derivative, k + joint * (DEGREE + 1)] for k in range(DEGREE + 1)]
            # from the highest coefficient down
            last = before = 0.0 * x
            for coefficient in series[:0:-1]:
                last, before = coefficient + 2.0 * x * last - before, last
            rows.append(series[0] + x * last - before)
    return casadi.vertcat(*rows)


class BoundFunction:
    """A function (t, z, piece) → (count,) on buffers of its own, for one piece, without conversions on the way.

    A matrix comes column by column; with several outputs one is chosen.
    """

    def __init__(self, function: casadi.Function, piece: RealArray, output: int = 0) -> None:
        self._time, self._state, self._piece = np.zeros(1), np.zeros(function.numel_in(1)), piece.copy()
        self._result = np.zeros(function.numel_out(output))
        self._function = function
        buffer: Any
        buffer, self._evaluate = function.buffer()
        self._kept = buffer  # the call needs it
        for i, values in enumerate((self._time, self._state, self._piece)):
            buffer.set_arg(i, values.data)
        buffer.set_res(output, self._result.data)

    def __call__(self, t: float, z: RealArray) -> RealArray:
        self._time[0] = t
        self._state[:] = z
        self._evaluate()
        return self._result.copy()
