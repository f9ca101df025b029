"""Trials with other people's solvers on the same equations, compiled: SciPy's, and SUNDIALS through CasADi."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Literal

import casadi
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from flexfmu.cosim.workprec.equations import NUMBERS, BoundFunction, Equations, equations
from flexfmu.cosim.workprec.fmu_trials import Announce
from flexfmu.cosim.workprec.motion_polynomials import Piece, pieces
from flexfmu.cosim.workprec.subject import RunError, Subject
from flexfmu.cosim.workprec.trial import Curve, Trial, fastest, sweep

Array = NDArray[np.float64]

Method = Literal["Radau", "BDF", "LSODA", "DOP853"]

SCIPY: tuple[Method, ...] = ("Radau", "BDF", "LSODA", "DOP853")
IMPLICIT: tuple[Method, ...] = ("Radau", "BDF", "LSODA")
"""Those that take a Jacobian."""

TOLERANCES = tuple(float(f"1e-{digits}") for digits in range(2, 13))
"""Relative tolerances from which a sweep takes as many as it needs."""

ABSOLUTE = 1e-4
"""Absolute tolerance of an elastic coordinate relative to the relative one, in its own magnitude [m]: 0.1 mm is what links
of this size bend."""


def scipy_trials(subject: Subject, ours: Curve, announce: Announce) -> Iterator[Trial]:
    """SciPy's solvers with the exact Jacobian, restarted at every breakpoint, positions at the instants of comparison."""
    system, parts = system_of(subject)
    for method in SCIPY:

        def trial(tolerance: float, method: Method = method) -> Trial:
            announce(f"SciPy {method}, tolerance {tolerance:.0e}")
            run = scipy_run(subject, system, parts, method, tolerance)
            return solver_trial(subject, f"SciPy {method}", f"{tolerance:.0e}", run)

        yield from sweep(TOLERANCES, trial, ours)


def sundials_trials(subject: Subject, ours: Curve, announce: Announce) -> Iterator[Trial]:
    """CVODES through CasADi, rate and exact Jacobian compiled, restarted at every breakpoint."""
    system, parts = system_of(subject)

    def trial(tolerance: float) -> Trial:
        announce(f"CasADi cvodes, tolerance {tolerance:.0e}")
        run = _sundials(subject, system, parts, "cvodes", tolerance)
        return solver_trial(subject, "CasADi cvodes", f"{tolerance:.0e}", run)

    yield from sweep(TOLERANCES, trial, ours)


def system_of(subject: Subject) -> tuple[Equations, tuple[Piece, ...]]:
    """Equations and motion of a motion-driven scene."""
    q1, q2 = subject.motion.joints.evaluate(0.0, 0)[0, 0]
    return equations(subject.scene, (float(q1), float(q2))), pieces(subject.motion.joints, subject.stop)


def solver_trial(subject: Subject, line: str, label: str, run: Callable[[], Array]) -> Trial:
    """One run of a solver: (N, 2) positions at the instants of comparison."""
    try:
        error = subject.error(run())
    except (RunError, RuntimeError, ValueError) as failure:
        return Trial("tools", line, label, None, None, " ".join(str(failure).split()))
    return Trial("tools", line, label, error, fastest(run))


def independent_reference(subject: Subject, tolerance: float = 1e-11) -> Array:
    """(N, 2) positions [m] by DOP853, which shares neither integrator nor master with ours."""
    system, parts = system_of(subject)
    return scipy_run(subject, system, parts, "DOP853", tolerance)()


def compared(subject: Subject, piece: Piece) -> Array:
    """Instants of comparison that belong to a piece, its beginning but not its end; the very last one to the last."""
    is_last = piece.end >= subject.stop * (1.0 - 1e-12)
    up_to = np.inf if is_last else piece.end
    return np.minimum(subject.instants[(subject.instants >= piece.begin) & (subject.instants < up_to)], piece.end)


def ends(instants: Array, end: float) -> Array:
    """The instants and the end of the piece, each once."""
    return instants if instants.size and instants[-1] == end else np.append(instants, end)


def scipy_run(
    subject: Subject,
    system: Equations,
    parts: tuple[Piece, ...],
    method: Method,
    tolerance: float,
    exact_jacobian: bool = True,
) -> Callable[[], Array]:
    """A run of one of SciPy's methods: (N, 2) positions [m] at the instants of comparison.

    Args:
        subject, system, parts: what is simulated.
        method: name of the method.
        tolerance: relative tolerance.
        exact_jacobian: False for SciPy's own finite differences.
    """
    rates = [system.bound(piece.numbers) for piece in parts]
    has_jacobian = exact_jacobian and method in IMPLICIT
    extra: list[dict[str, Any]] = [
        {"jac": system.bound_jacobian(piece.numbers)} if has_jacobian else {} for piece in parts
    ]
    positions = [BoundFunction(system.position, piece.numbers) for piece in parts]

    def run() -> Array:
        state, found = system.start, []
        for piece, rate, position, options in zip(parts, rates, positions, extra, strict=True):
            instants = compared(subject, piece)
            wanted = ends(instants, piece.end)
            solution = solve_ivp(
                rate,
                (piece.begin, piece.end),
                state,
                method,
                wanted,
                rtol=tolerance,
                atol=ABSOLUTE * tolerance,
                **options,
            )
            if not solution.success:
                raise RunError(solution.message)
            found += [position(t, z) for t, z in zip(instants, solution.y.T, strict=False)]
            state = solution.y[:, -1]
        return np.array(found)

    return run


def _sundials(
    subject: Subject, system: Equations, parts: tuple[Piece, ...], plugin: str, tolerance: float
) -> Callable[[], Array]:
    t, z, p = casadi.MX.sym("t"), casadi.MX.sym("z", 2 * system.n), casadi.MX.sym("p", NUMBERS)
    problem = {"t": t, "x": z, "p": p, "ode": system.rate(t, z, p)}
    options = {"reltol": tolerance, "abstol": ABSOLUTE * tolerance, "max_num_steps": 1_000_000}
    solvers = []
    for piece in parts:
        instants = compared(subject, piece)
        solver = casadi.integrator("run", plugin, problem, piece.begin, ends(instants, piece.end).tolist(), options)
        position = BoundFunction(system.position, piece.numbers)
        solvers.append((piece.numbers, instants, solver, position))

    def run() -> Array:
        state, found = system.start, []
        for numbers, instants, solver, position in solvers:
            states = solver(x0=state, p=numbers)["xf"].full()
            found += [position(t, z) for t, z in zip(instants, states.T, strict=False)]
            state = states[:, -1]
        return np.array(found)

    return run
