"""Models from a user's equations as `SymbolicModel`: states of first order, coordinates of second order, Lagrange's equations, and
constraints that determine further variables (semi-explicit differential-algebraic equations of index 1).

Equations are functions of named symbols, or CasADi expressions of symbols with these names. A function takes any of the arguments
``q``, ``v``, ``a`` (coordinates, their rates and accelerations), ``x`` (states of first order), ``z`` (variables of constraints), ``u``
(inputs), ``p`` (parameters, derived ones too), ``s`` (sides of events) and ``t`` (time [s])::

    vdp = ode("vdp", x={"x0": 2.0, "x1": 0.0}, p={"mu": 1.0}, rhs=lambda x, p: [x.x1, p.mu * (1 - x.x0**2) * x.x1 - x.x0])

Constraints that are linear in z are solved as they stand. Others are solved by ten of Newton's iterations from a guess, a further
state that follows the solution; where these don't converge the equations give no number, and the integrator takes shorter steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isfinite
from numbers import Real
from typing import Any, Unpack

import casadi
import numpy as np

from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.interface import find_states
from flexfmu.fmu_build.own_assembly import assembled
from flexfmu.fmu_build.own_draft import SINGULAR, Draft
from flexfmu.fmu_build.own_entries import Common, Equation, Mechanics, column, event, part, variable
from flexfmu.model.contract import Linearisation, LinearPlant
from flexfmu.model.symbolic import SymbolicModel

__all__ = ["dae", "event", "lagrangian", "linear_about", "ode", "part", "second_order", "variable"]

RELAXATION = 1e4
"""Rate [1/s] at which the guess of a nonlinear constraint's solution follows it; far above the motions of most models."""

CONVERGED = 1e-7
"""Largest last correction of Newton's iterations relative to the size of z: the error that it leaves is about its square."""

DAMPED_ITERATIONS, SHARES = 8, (1 / 8, 1 / 2, 1.0, 4.0)
"""Newton iterations for constraints, in every evaluation of the equations, that may take a share of the step or, where an exponential
function makes it short, a multiple; two whole ones follow."""

START_ITERATIONS, HALVINGS = 100, 40
"""Newton iterations for constraints at the start, and halvings of each step."""


def ode(name: str, *, x: Mapping[str, Any], rhs: Equation, **common: Unpack[Common]) -> SymbolicModel:
    """A model of first order: x' = rhs(x, u, p, t).

    Args:
        name: name of the model.
        x: state → start value, a number or `variable`; the FMU has it as parameter ``start.NAME`` too.
        rhs: the states' time derivatives, a function of x, u, p and t.
        common: inputs ``u``, parameters ``p``, ``derived`` parameters, ``outputs``, ``events`` and ``description``, see
            `flexfmu.fmu_build.own_entries.Common`; the states and their derivatives, ``der(NAME)``, are outputs anyway.

    Raises:
        ModelError: an equation, a name, a start value or a unit is wrong.
    """
    draft = Draft(name, x=x, **common)
    return assembled(draft, [], draft.evaluated("rhs", rhs, draft.states))


def second_order(
    name: str, *, q: Mapping[str, Any], residual: Equation, rhs: Equation = (), **common: Unpack[Mechanics]
) -> SymbolicModel:
    """A model of second order: residual(q, v, a, u, p, t) = M(q, u, p, t) a + b(q, v, u, p, t) = 0, one equation for each coordinate.

    M, the derivative of the residual by the accelerations, must be symmetric and definite, as that of Lagrange's equations is.

    Args:
        name: name of the model.
        q: coordinate → start value, a number or `variable`.
        residual: the equations, a function of q, v, a, u, p, x and t, in the order of q or by coordinate.
        rhs: time derivatives of the states ``x``; M may not depend on these.
        common: as for `ode`, and ``rates``, ``x`` and ``friction``, see `flexfmu.fmu_build.own_entries.Mechanics`; the coordinates
            with their rates ``der(NAME)`` and accelerations ``der(NAME,2)`` are outputs anyway.

    Raises:
        ModelError: an equation, a name, a start value or a unit is wrong, or M isn't symmetric and definite.
    """
    draft = Draft(name, q=q, **common)
    equations = draft.evaluated("residual", residual, list(q))
    return assembled(draft, equations, draft.evaluated("rhs", rhs, draft.states))


def lagrangian(
    name: str,
    *,
    q: Mapping[str, Any],
    kinetic: Equation,
    potential: Equation = 0.0,
    dissipation: Equation = 0.0,
    forces: Equation = None,
    rhs: Equation = (),
    **common: Unpack[Mechanics],
) -> SymbolicModel:
    """A model from its energies, by Lagrange's equations d/dt dT/dv - d(T - V)/dq + dR/dv = Q.

    Args:
        name: name of the model.
        q: coordinate → start value, a number or `variable`.
        kinetic: kinetic energy T [J], a function of q, v, p and t.
        potential: potential energy V [J], a function of q, p, u and t.
        dissipation: Rayleigh's function R [W], half of the power that dampers take, a function of q, v and p.
        forces: generalised forces Q, a function of q, v, u, p, x and t, in the order of q, or by coordinate with zero for others.
        rhs, common: as for `second_order`.

    Raises:
        ModelError: as for `second_order`.
    """
    draft = Draft(name, q=q, **common)
    (t_energy,), (v_energy,), (rayleigh,) = (
        draft.evaluated(what, source, [what])
        for what, source in (("kinetic", kinetic), ("potential", potential), ("dissipation", dissipation))
    )
    applied = draft.evaluated("forces", {} if forces is None else forces, list(q), missing=0.0)
    # d/dt along the motion: q changes by v, v by a, time by 1
    n, y, v, a = len(q), draft.y, draft.v, draft.a
    moved, rate = casadi.vertcat(y[:n], v[:n], draft.time), casadi.vertcat(v[:n], a[:n], 1)
    momentum = casadi.gradient(t_energy, v[:n])
    equations = casadi.jtimes(momentum, moved, rate) - casadi.gradient(t_energy - v_energy, y[:n])
    equations += casadi.gradient(rayleigh, v[:n]) - casadi.vertcat(*applied)
    return assembled(draft, casadi.vertsplit(equations), draft.evaluated("rhs", rhs, draft.states))


def dae(
    name: str,
    *,
    x: Mapping[str, Any],
    z: Mapping[str, Any],
    rhs: Equation,
    constraints: Equation,
    **common: Unpack[Common],
) -> SymbolicModel:
    """A model with constraints: x' = rhs(x, z, u, p, t), 0 = constraints(x, z, u, p, t), of index 1: they determine z.

    Args:
        name: name of the model.
        x: state → start value, a number or `variable`.
        z: variable that the constraints determine → guess of its value at the start; it is an output.
        rhs, constraints: functions of x, z, u, p and t.
        common: as for `ode`; outputs may depend on z.

    Raises:
        ModelError: as for `ode`, or the constraints don't determine z, as where the index is 2 or 3.
    """

    def drafted(states: Mapping[str, Any]) -> tuple[Draft, casadi.SX, casadi.SX]:
        """A draft with these states, the constraints, and their derivatives by z."""
        draft = Draft(name, x=states, z=z, **common)
        defect = column(draft.evaluated("constraints", constraints, [f"0 ({each})" for each in z]))
        return draft, defect, casadi.jacobian(defect, draft.unsolved)

    if not z:
        raise ModelError(f"model '{name}' has no variables z for its constraints; without any it is an ode")
    draft, defect, slope = drafted(x)
    guess = _solved_start(draft, defect, slope)
    if not casadi.depends_on(slope, draft.unsolved):
        draft.solution = casadi.solve(slope, -casadi.substitute(defect, draft.unsolved, casadi.SX.zeros(len(z))))
        return assembled(draft, [], draft.evaluated("rhs", rhs, list(x)))
    # further states that follow the solution, from which Newton's method starts
    given = draft.given["z"]
    if taken := [each for each in x if each.startswith("guess.")]:
        raise ModelError(f"state '{taken[0]}' of model '{name}' can't have this name: guess.* are the FMU's own")
    follows = {f"guess.{each}": replace(given[each], value=value) for each, value in guess.items()}
    draft, defect, slope = drafted({**x, **follows})
    solution = guesses = column([draft.scopes["x"][each] for each in follows])
    sizes = column([each.size for each in follows.values()])

    def newton(z: casadi.SX) -> tuple[casadi.SX, casadi.SX]:
        """The matrix at z, and the step from there."""
        matrix, left = (casadi.substitute(each, draft.unsolved, z) for each in (slope, defect))
        return matrix, casadi.solve(matrix, -left)

    for _ in range(DAMPED_ITERATIONS):
        matrix, step = newton(solution)
        # the largest share of the step behind which the next one with the same matrix is smaller, or the least share
        share = casadi.SX(SHARES[0])
        for each in SHARES[1:]:
            behind = casadi.solve(matrix, casadi.substitute(defect, draft.unsolved, solution + each * step))
            is_smaller = casadi.sumsqr(behind / sizes) < casadi.sumsqr(step / sizes)
            share = casadi.if_else(is_smaller, each, share)
        solution = solution + share * step
    # two whole ones, behind which the first and second derivatives are exact whatever those of their start
    draft.iterated, solution = solution, draft.unsolved
    for _ in range(2):
        _, step = newton(solution)
        solution = solution + step
    draft.solution = solution
    # the root of a negative number is no number, where the last correction is too large
    gate = 1e-300 * casadi.sqrt(1 - casadi.sumsqr(step / (CONVERGED * (sizes + casadi.fabs(solution)))))
    rates = [each + gate for each in draft.evaluated("rhs", rhs, list(x))]
    # the solution's own rate but for that of inputs, dz/dt = -(dg/dz)^-1 (dg/dx dx/dt + dg/dt), and what is left of the distance
    moved = casadi.vertcat(column([draft.scopes["x"][each] for each in x]), draft.time)
    drift = casadi.substitute(casadi.jacobian(defect, moved), draft.unsolved, solution) @ casadi.vertcat(*rates, 1)
    rate = casadi.solve(newton(solution)[0], -drift) + RELAXATION * (solution - guesses)
    return replace(assembled(draft, [], [*rates, *casadi.vertsplit(rate)]), iterated=tuple(z))


def _solved_start(draft: Draft, defect: casadi.SX, slope: casadi.SX) -> dict[str, float]:
    """The solution of the constraints at the start, by Newton's method with steps that are halved until the next one is smaller.

    Raises:
        ModelError: the constraints don't determine z, or the iteration doesn't converge.
    """
    names, given = list(draft.given["z"]), draft.given["z"].values()
    function = draft.at_start(casadi.horzcat(defect, slope), draft.unsolved)
    value, sizes = np.array([[each.value, each.size] for each in given]).T
    both = function(value).full()
    for _ in range(START_ITERATIONS):
        if not np.isfinite(both).all():
            break
        # every constraint and variable in its own size
        matrix = both[:, 1:] * sizes
        rows = 1.0 / np.where(matrix.any(axis=1), abs(matrix).max(axis=1), 1.0)
        left, stretches, right = np.linalg.svd(matrix * rows[:, None])
        if stretches[-1] <= SINGULAR * max(stretches[0], 1e-300):
            remedy = "give another guess in z; or " if casadi.depends_on(slope, draft.unsolved) else ""
            raise ModelError(
                f"the constraints of model '{draft.name}' don't determine '{names[int(np.argmax(abs(right[-1])))]}' (constraint "
                f"{int(np.argmax(abs(left[:, -1]))) + 1} doesn't change with it): {remedy}the index is 2 or 3; differentiate that "
                "constraint by time until it holds the variable, or take second_order or lagrangian with coordinates that fulfil it"
            )
        step = np.linalg.solve(matrix, both[:, 0])
        if (abs(sizes * step) <= 1e-10 * (sizes + abs(value))).all():
            return dict(zip(names, (value - sizes * step).tolist(), strict=True))
        for share in 0.5 ** np.arange(HALVINGS):
            both = function(value - share * sizes * step).full()
            behind = np.linalg.solve(matrix, both[:, 0])
            if np.isfinite(both).all() and np.linalg.norm(behind) <= np.linalg.norm(step):
                break
        value = value - share * sizes * step
    guess = ", ".join(f"{each} = {one.value:g}" for each, one in draft.given["z"].items())
    raise ModelError(
        f"the constraints of model '{draft.name}' can't be solved at the start from the guess {guess}; give a better one in z"
    )


def linear_about(model: SymbolicModel, point: Mapping[str, float], outputs: Sequence[str] | None = None) -> LinearPlant:
    """A model of this module about a point, with the accelerations that belong to it.

    Args:
        model: the model; its parameters have their start values.
        point: state or input → value; the start value for others.
        outputs: names of outputs; None for all.

    Raises:
        ModelError: a name is unknown, or a value or the model at the point isn't finite.
    """
    # where each state lies in [y, v], and each input
    start = model.functions["initial_coordinates"]([each.start or 0.0 for each in model.parameters]).full().ravel()
    places = dict(zip((model.outputs[k].name for k in find_states(model).outputs), model.states, strict=True))
    inputs = {each.name: k for k, each in enumerate(model.inputs)}
    u = np.array([each.start or 0.0 for each in model.inputs])
    for name, value in point.items():
        if name not in places and name not in inputs:
            raise ModelError(
                f"model '{model.name}' has no state or input '{name}'; it has {', '.join([*places, *inputs])}"
            )
        if not isinstance(value, Real) or not isfinite(value):
            raise ModelError(f"{name} of the point must be a finite number, got {value!r}")
        if name in places:
            start[places[name]] = value
        else:
            u[inputs[name]] = value
    known = {each.name for each in model.outputs}
    if unknown := [each for each in outputs or () if each not in known]:
        raise ModelError(f"model '{model.name}' has no output '{unknown[0]}'; it has {', '.join(sorted(known))}")
    # accelerations there: M a = -b
    y, v = np.split(start, 2)
    derived = model.functions["derive"]([each.start or 0.0 for each in model.parameters])
    mass = model.functions["mass_matrix"](y, u, derived).full()
    a = -np.linalg.solve(mass, model.functions["residual"](y, v, 0.0 * v, u, derived).full().ravel())
    if not np.isfinite(a).all():
        raise ModelError(f"the equations of model '{model.name}' give no finite number at the point")
    return Linearisation.of(model).about(
        (y, v, a, u), [each.name for each in model.outputs] if outputs is None else outputs
    )
