"""Trials with another formulation of the same robot: all coordinates with multipliers (index 1), with and without Baumgarte's
stabilisation, against the minimal coordinates; the same solver for all."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import casadi
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from flexfmu.cosim.blocks.code import compile_function
from flexfmu.cosim.workprec.equations import NUMBERS, BoundFunction, joint_motion
from flexfmu.cosim.workprec.fmu_trials import Announce
from flexfmu.cosim.workprec.motion_polynomials import Piece
from flexfmu.cosim.workprec.solver_trials import ABSOLUTE, Method, compared, ends, scipy_run, system_of
from flexfmu.cosim.workprec.subject import RunError, Subject
from flexfmu.cosim.workprec.trial import Trial, fastest
from flexfmu.model.multipliers import PASSIVE, ConstrainedModel, constrained_model

Array = NDArray[np.float64]

SOLVER: Method = "Radau"
TOLERANCES = (1e-3, 1e-5, 1e-7)

RATES = {"index 1": 0.0, "index 1, Baumgarte 100/s": 100.0}
"""Line → rate of the stabilisation [1/s]."""


def formulation_trials(subject: Subject, announce: Announce) -> Iterator[Trial]:
    """SciPy's Radau on every formulation; notes tell the largest violation of the constraints."""
    system, parts = system_of(subject)
    for tolerance in TOLERANCES:
        announce(f"minimal coordinates, {SOLVER}, tolerance {tolerance:.0e}")
        run = scipy_run(subject, system, parts, SOLVER, tolerance, exact_jacobian=False)  # nor have the others one
        label = f"{tolerance:.0e}"
        yield Trial("formulations", "minimal coordinates", label, subject.error(run()), fastest(run), "no constraints")
    model = constrained_model(subject.scene)
    for line, rate in RATES.items():
        function = compile_function(index_one(model, rate))
        for tolerance in TOLERANCES:
            announce(f"{line}, {SOLVER}, tolerance {tolerance:.0e}")
            yield _index_one_trial(subject, model, function, parts, line, tolerance)


def index_one(model: ConstrainedModel, rate: float) -> casadi.Function:
    """(t, z, piece) → dz/dt for z = [q, dq/dt] with all 10 + n coordinates, motors driven by the planned motion."""
    size = 10 + model.n
    t, z, piece = casadi.MX.sym("t"), casadi.MX.sym("z", 2 * size), casadi.MX.sym("piece", NUMBERS)
    q, v = z[:size], z[size:]
    psi = model.jacobian(q)
    motors = casadi.horzcat(casadi.DM.eye(2), casadi.DM.zeros(2, size - 2))
    rows = casadi.vertcat(psi, motors)
    drift = model.curvature(q, v) + 2.0 * rate * (psi @ v) + rate**2 * model.constraints(q)
    matrix = casadi.blockcat([[model.mass_matrix(q), rows.T], [rows, casadi.DM.zeros(PASSIVE + 2, PASSIVE + 2)]])
    known = casadi.vertcat(-model.bias(q, v), -drift, joint_motion(t, piece)[4:])
    acceleration = casadi.solve(matrix, known, "qr")[:size]
    return casadi.Function("index_one", [t, z, piece], [casadi.densify(casadi.vertcat(v, acceleration))])


def _index_one_trial(
    subject: Subject,
    model: ConstrainedModel,
    function: casadi.Function,
    parts: tuple[Piece, ...],
    line: str,
    tolerance: float,
) -> Trial:
    run = _index_one_run(subject, model, function, parts, tolerance)
    label = f"{tolerance:.0e}"
    try:
        states = run()
    except (RunError, ValueError) as failure:
        return Trial("formulations", line, label, None, None, " ".join(str(failure).split()))
    size = 10 + model.n
    violation = max(float(np.abs(model.constraints(state[:size]).full()).max()) for state in states)
    note = f"constraints violated by up to {violation:.1e} m"
    return Trial("formulations", line, label, subject.error(states[:, size - 2 : size]), fastest(run), note)


def _index_one_run(
    subject: Subject, model: ConstrainedModel, function: casadi.Function, parts: tuple[Piece, ...], tolerance: float
) -> Callable[[], Array]:
    rates = [BoundFunction(function, piece.numbers) for piece in parts]
    joints = subject.motion.joints.evaluate(0.0, 0)[0, 0]
    elastic, still = system_of(subject)[0].start[: model.n], np.zeros(model.n)
    start = np.concatenate([part.full().ravel() for part in model.assembled(joints, elastic, np.zeros(2), still)])

    def run() -> Array:
        """(N, 2 (10 + n)) states at the instants of comparison."""
        state, found = start, []
        for piece, rate in zip(parts, rates, strict=True):
            instants = compared(subject, piece)
            span, wanted = (piece.begin, piece.end), ends(instants, piece.end)
            with np.errstate(
                over="ignore"
            ):  # SciPy's finite difference by a coordinate that nothing depends on grows without bound
                solution = solve_ivp(rate, span, state, SOLVER, wanted, rtol=tolerance, atol=ABSOLUTE * tolerance)
            if not solution.success:
                raise RunError(solution.message)
            found.append(solution.y.T[: instants.size])
            state = solution.y[:, -1]
        return np.concatenate(found)

    return run
