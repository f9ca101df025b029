"""The motion-driven robot as an initial value problem, compiled, and trials of other solvers with it: SciPy's, and SUNDIALS through CasADi;
with another formulation of the same robot: all coordinates with multipliers (index 1), with and without Baumgarte's stabilisation; and with
the paper's own setting of the solver.

Solvers evaluate the equations at one instant at a time. The planned joint motion is therefore interpolated by Chebyshev polynomials
between its breakpoints, which the equations evaluate by Clenshaw's recurrence (Clenshaw, Math. Comp. 9, 1955). All solvers restart where
the motion's derivatives jump. Sources: SciPy's `solve_ivp` (Radau: Hairer and Wanner, Solving Ordinary Differential Equations II,
sec. IV.8; DOP853: the same, I, sec. II.5); SUNDIALS: Hindmarsh et al., ACM Trans. Math. Softw. 31 (2005); Baumgarte, Comput. Methods
Appl. Mech. Eng. 1 (1972).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import pairwise
from typing import Any, Literal

import casadi
import numpy as np
from numpy.polynomial import chebyshev
from scipy.integrate import solve_ivp

from flexfmu.cosim.control.blocks.code import bound, compile_function
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.accuracy import WorkCurve, WorkPrecisionTrial
from flexfmu.cosim.experiment.timing import fastest
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.studies.workprec.trial import SAMPLING, RunError, SceneUnderTest, completed, sweep
from flexfmu.model.multipliers import PASSIVE, ConstrainedModel, constrained_model
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
        arguments, results = (self._time, self._state, self._piece), [*[None] * output, self._result]
        self._kept, self._evaluate = bound(function, arguments, results)

    def __call__(self, t: float, z: RealArray) -> RealArray:
        self._time[0] = t
        self._state[:] = z
        self._evaluate()
        return self._result.copy()


ScipyMethod = Literal["Radau", "BDF", "LSODA", "DOP853"]

SCIPY: tuple[ScipyMethod, ...] = ("Radau", "BDF", "LSODA", "DOP853")
IMPLICIT: tuple[ScipyMethod, ...] = ("Radau", "BDF", "LSODA")
"""Methods that use a Jacobian."""

TOLERANCES = tuple(float(f"1e-{digits}") for digits in range(2, 13))
"""Relative tolerances from which a sweep takes as many as it needs."""

ABSOLUTE = 1e-4
"""Absolute tolerance of an elastic coordinate relative to the relative one, in its own magnitude [m]: 0.1 mm is what links
of this size bend."""


def scipy_trials(subject: SceneUnderTest, ours: WorkCurve) -> Iterator[WorkPrecisionTrial]:
    """SciPy's solvers with the exact Jacobian, restarted at every breakpoint, positions at the instants of comparison."""
    for method in SCIPY:

        def run(tolerance: float, method: ScipyMethod = method) -> Callable[[], RealArray]:
            return scipy_run(subject, *system_of(subject), method, tolerance)

        yield from _solver_trials(subject, ours, f"SciPy {method}", run)


def sundials_trials(subject: SceneUnderTest, ours: WorkCurve) -> Iterator[WorkPrecisionTrial]:
    """CVODES through CasADi, rate and exact Jacobian compiled, restarted at every breakpoint."""
    yield from _solver_trials(subject, ours, "CasADi cvodes", partial(_sundials_run, subject))


def _solver_trials(
    subject: SceneUnderTest, ours: WorkCurve, line: str, run: Callable[[float], Callable[[], RealArray]]
) -> Iterator[WorkPrecisionTrial]:
    """Trials of a solver over tolerances, whose ``run`` gives (N, 2) positions at the instants of comparison."""

    def trial(tolerance: float) -> WorkPrecisionTrial:
        simulate = run(tolerance)

        def measure() -> tuple[float, float, str]:
            return subject.error(simulate()), fastest(simulate), ""

        return subject.trial("tools", line, f"{tolerance:.0e}", measure, RuntimeError, ValueError)

    yield from sweep(TOLERANCES, trial, ours)


def system_of(subject: SceneUnderTest) -> tuple[InitialValueProblem, tuple[MotionPolynomial, ...]]:
    """Equations and motion of a motion-driven scene."""
    q1, q2 = subject.motion.joints.evaluate(0.0, 0)[0, 0]
    return equations(subject.scene, (float(q1), float(q2))), motion_polynomials(subject.motion.joints, subject.stop)


def independent_reference(subject: SceneUnderTest, tolerance: float = 1e-11) -> RealArray:
    """(N, 2) positions [m] by DOP853, which shares neither integrator nor master with ours."""
    system, parts = system_of(subject)
    return scipy_run(subject, system, parts, "DOP853", tolerance)()


def compared(subject: SceneUnderTest, piece: MotionPolynomial) -> RealArray:
    """Instants of comparison that belong to a piece, its beginning but not its end; the very last one to the last."""
    is_last = piece.end >= subject.stop * (1.0 - 1e-12)
    up_to = np.inf if is_last else piece.end
    return np.minimum(subject.instants[(subject.instants >= piece.begin) & (subject.instants < up_to)], piece.end)


def ends(instants: RealArray, end: float) -> RealArray:
    """The instants and the end of the piece, each once."""
    return instants if instants.size and instants[-1] == end else np.append(instants, end)


def solve_piece(
    rate: Callable[[float, RealArray], RealArray],
    span: tuple[float, float],
    state: RealArray,
    instants: RealArray,
    method: ScipyMethod,
    tolerance: float,
    absolute: float | RealArray,
    **options: Any,
) -> tuple[RealArray, RealArray]:
    """Integrate from one jump of the equations to the next.

    Args:
        rate: (t, z) → dz/dt.
        span: beginning and end [s].
        state: z at the beginning (m,).
        instants: (N,) ascending, within the span [s].
        method: one of SciPy's.
        tolerance, absolute: relative and absolute tolerance.
        options: for `scipy.integrate.solve_ivp`.

    Returns:
        States at the instants (N, m) and at the end (m,).

    Raises:
        RunError: the solver fails.
    """
    wanted = ends(instants, span[1])
    solution = solve_ivp(rate, span, state, method, wanted, rtol=tolerance, atol=absolute, **options)
    if not solution.success:
        raise RunError(solution.message)
    return solution.y.T[: instants.size], solution.y[:, -1]


def scipy_run(
    subject: SceneUnderTest,
    system: InitialValueProblem,
    parts: tuple[MotionPolynomial, ...],
    method: ScipyMethod,
    tolerance: float,
    exact_jacobian: bool = True,
) -> Callable[[], RealArray]:
    """A run of one of SciPy's methods: (N, 2) positions [m] at the instants of comparison.

    Args:
        subject, system, parts: what is simulated.
        method: name of the method.
        tolerance: relative tolerance.
        exact_jacobian: False for SciPy's own finite differences.
    """
    jacobian = system.bound_jacobian if exact_jacobian and method in IMPLICIT else None

    def position(piece: RealArray) -> BoundFunction:
        return BoundFunction(system.position, piece)

    return _scipy_over_pieces(subject, parts, system.start, (system.rate, jacobian, position), method, tolerance)


ByPiece = Callable[[RealArray], Callable[[float, RealArray], RealArray]]
"""Numbers of a piece → function of time and state."""


def _scipy_over_pieces(
    subject: SceneUnderTest,
    parts: tuple[MotionPolynomial, ...],
    start: RealArray,
    functions: tuple[casadi.Function, ByPiece | None, ByPiece],
    method: ScipyMethod,
    tolerance: float,
) -> Callable[[], RealArray]:
    """A run from ``start``; ``functions`` are the rate, its Jacobian, if known, and what is wanted at the instants of comparison."""
    rate, jacobian, observe = functions
    # functions of each piece, bound once
    pieces = [
        (
            piece,
            compared(subject, piece),
            BoundFunction(rate, piece.numbers),
            observe(piece.numbers),
            {} if jacobian is None else {"jac": jacobian(piece.numbers)},
        )
        for piece in parts
    ]

    def run() -> RealArray:
        state, found = start, []
        # the solver starts anew at each piece, where derivatives of the motion jump
        for piece, instants, rate, observed, options in pieces:
            span, absolute = (piece.begin, piece.end), ABSOLUTE * tolerance
            # SciPy's finite difference by a coordinate without influence grows without bound
            with np.errstate(over="ignore"):
                states, state = solve_piece(rate, span, state, instants, method, tolerance, absolute, **options)
            found += [observed(t, z) for t, z in zip(instants, states, strict=True)]
        return np.array(found)

    return run


def _sundials_run(subject: SceneUnderTest, tolerance: float) -> Callable[[], RealArray]:
    system, parts = system_of(subject)
    t, z, p = casadi.MX.sym("t"), casadi.MX.sym("z", 2 * system.n), casadi.MX.sym("p", NUMBERS)
    problem = {"t": t, "x": z, "p": p, "ode": system.rate(t, z, p)}
    options = {"reltol": tolerance, "abstol": ABSOLUTE * tolerance, "max_num_steps": 1_000_000}
    # an integrator for each piece, whose times CasADi wants beforehand
    solvers = []
    for piece in parts:
        instants = compared(subject, piece)
        solver = casadi.integrator("run", "cvodes", problem, piece.begin, ends(instants, piece.end).tolist(), options)
        solvers.append((piece.numbers, instants, solver, BoundFunction(system.position, piece.numbers)))

    def run() -> RealArray:
        state, found = system.start, []
        for numbers, instants, solver, position in solvers:
            states = solver(x0=state, p=numbers)["xf"].full()
            found += [position(t, z) for t, z in zip(instants, states.T, strict=False)]
            state = states[:, -1]
        return np.array(found)

    return run


SOLVER: ScipyMethod = "Radau"
FORMULATION_TOLERANCES = (1e-3, 1e-5, 1e-7)

RATES = {"index 1": 0.0, "index 1, Baumgarte 100/s": 100.0}
"""Line → rate of the stabilisation [1/s]."""


def formulation_trials(subject: SceneUnderTest) -> Iterator[WorkPrecisionTrial]:
    """SciPy's Radau on every formulation, without exact Jacobians; notes have the largest violation of the constraints."""
    system, parts = system_of(subject)
    for tolerance in FORMULATION_TOLERANCES:
        run = scipy_run(subject, system, parts, SOLVER, tolerance, exact_jacobian=False)

        def minimal(run: Callable[[], RealArray] = run) -> tuple[float, float, str]:
            return subject.error(run()), fastest(run), "no constraints"

        yield subject.trial("formulations", "minimal coordinates", f"{tolerance:.0e}", minimal)
    # all coordinates: from static equilibrium, or undeformed, with the passive ones that assemble the mechanism
    model = constrained_model(subject.scene)
    size, joints = 10 + model.n, subject.motion.joints.evaluate(0.0, 0)[0, 0]
    assembled = model.assembled(joints, system.start[: model.n], np.zeros(2), np.zeros(model.n))
    start = np.concatenate([part.full().ravel() for part in assembled])
    for line, rate in RATES.items():
        functions = compile_function(index_one(model, rate)), None, lambda piece: lambda t, z: z
        for tolerance in FORMULATION_TOLERANCES:
            run = _scipy_over_pieces(subject, parts, start, functions, SOLVER, tolerance)

            def index_1(run: Callable[[], RealArray] = run) -> tuple[float, float, str]:
                states = run()
                violation = max(float(np.abs(model.constraints(state[:size]).full()).max()) for state in states)
                note = f"constraints violated by up to {violation:.1e} m"
                return subject.error(states[:, size - 2 : size]), fastest(run), note

            yield subject.trial("formulations", line, f"{tolerance:.0e}", index_1, ValueError)


def index_one(model: ConstrainedModel, rate: float) -> casadi.Function:
    """(t, z, piece) → dz/dt for z = [q, dq/dt] with all 10 + n coordinates, motors driven by the planned motion."""
    size = 10 + model.n
    t, z, piece = casadi.MX.sym("t"), casadi.MX.sym("z", 2 * size), casadi.MX.sym("piece", NUMBERS)
    q, v = z[:size], z[size:]
    # constraints of the loop, and of the driven motors
    psi = model.jacobian(q)
    motors = casadi.horzcat(casadi.DM.eye(2), casadi.DM.zeros(2, size - 2))
    rows = casadi.vertcat(psi, motors)
    drift = model.curvature(q, v) + 2.0 * rate * (psi @ v) + rate**2 * model.constraints(q)
    # accelerations and multipliers from M a + Jᵀ λ = -b and J a = (-drift, planned joint accelerations)
    matrix = casadi.blockcat([[model.mass_matrix(q), rows.T], [rows, casadi.DM.zeros(PASSIVE + 2, PASSIVE + 2)]])
    known = casadi.vertcat(-model.bias(q, v), -drift, joint_motion(t, piece)[4:])
    acceleration = casadi.solve(matrix, known, "qr")[:size]
    return casadi.Function("index_one", [t, z, piece], [casadi.densify(casadi.vertcat(v, acceleration))])


PAPER_LINE = "fixed step of 10 MHz"

PAPER_STEP = 1e-7
"""The paper's fixed step: 10 MHz."""

PAPER_SHARE = 50
"""Ratio of the whole time to the part simulated at 10 MHz; a whole run would take a minute."""


def paper_trial(subject: SceneUnderTest) -> WorkPrecisionTrial:
    """The classical Runge-Kutta method at 10 MHz over the beginning of the motion, its time scaled up."""
    changes = {"cosimulation.integrator": "rk4", "cosimulation.integrator_step": PAPER_STEP}
    # the beginning alone, a whole number of sample instants
    share = SAMPLING * max(1, round(subject.stop / SAMPLING / PAPER_SHARE))

    def measure() -> tuple[float, float, str]:
        prepared = PreparedScene(subject.scene.replace(changes), communication_step=SAMPLING, motion=subject.motion)
        prepared.stop_time = share
        error = subject.error(subject.positions(completed(prepared.run())))
        note = f"simulated to {1e3 * share:.0f} ms, the time multiplied by {subject.stop / share:.0f}"
        return error, fastest(prepared.run) * subject.stop / share, note

    return subject.trial("tools", PAPER_LINE, "0.1 µs", measure)
