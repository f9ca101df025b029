"""The model contract from a user's checked equations: variables, functions, events, and what depends on what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi
import numpy as np

from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.own_draft import SINGULAR, Draft
from flexfmu.fmu_build.own_entries import column, rate_unit, variable
from flexfmu.model.contract import contract_functions
from flexfmu.model.symbolic import Causality, Event, Friction, SymbolicModel, Variable
from flexfmu.model.time_derivatives import MotionSymbols, acceleration_terms

DRAWN = 3
"""Number of points at which the symmetry of a mass matrix is checked beside the start."""

Shown = list[tuple[Variable, casadi.SX]]
"""Outputs with their expressions."""


def assembled(draft: Draft, residual: Sequence[casadi.SX], rhs: Sequence[casadi.SX]) -> SymbolicModel:
    """The model with these equations of second and first order.

    Raises:
        ModelError: an output is wrong, or the mass matrix isn't symmetric and definite.
    """
    n, second = draft.y.numel(), draft.n_second
    equations = _definite(draft, column(residual))
    # friction acts against the direction of slip, on the equations with a positive mass matrix
    frictions, first = [], draft.d.numel() - len(draft.events) - 2 * len(draft.friction)
    for k, (each, (_, slip)) in enumerate(draft.friction.items()):
        found = Friction(list(draft.given["q"]).index(each), first + k, first + len(draft.friction) + k)
        (force,) = draft.evaluated(f"friction of '{each}'", slip, [each], scopes="qvp")
        both = draft.at_start(casadi.vertcat(draft.d[found.breakaway], force), casadi.SX(0, 1))([]).full().ravel()
        if not 0.0 <= both[1] <= both[0]:
            raise ModelError(
                f"friction of '{each}' of model '{draft.name}' must be zero or positive, and while it slips at most that of breakaway, "
                f"got {both[0]:g} and {both[1]:g} at the start"
            )
        equations[found.unknown] += draft.d[found.direction] * force
        frictions.append(found)
    rates = [*rhs, *[casadi.SX(0)] * draft.n_held]
    equations = casadi.vertcat(equations, draft.a[second : n - 1] - column(rates), draft.a[n - 1])
    shown = _outputs(draft)
    everything = casadi.vertcat(*(value for _, value in shown))
    # the clock is there where something depends on it
    constant = column([draft.v[second + k] for k, rate in enumerate(rates) if rate.is_zero()])
    numbers = column([draft.evaluated(f"event '{each}'", e.number, [each])[0] for each, e in draft.events.items()])
    for each, number in zip(draft.events, casadi.vertsplit(numbers), strict=True):
        if number.is_constant():
            raise ModelError(
                f"the number of event '{each}' of model '{draft.name}' is constant, so that it never happens"
            )
    has_clock = casadi.depends_on(casadi.vertcat(equations, everything, numbers), draft.time)
    kept = n if has_clock else n - 1
    motion = MotionSymbols(draft.y[:kept], draft.v[:kept], draft.a[:kept], draft.u)
    equations = equations[:kept]
    # error norm and start, of states alone
    nominals = _nominals(draft)
    weights = [1 / each**2 for each in nominals]
    scale = [*weights[:second], *[0.0] * (kept - second), *weights[second:], *[0.0] * has_clock, 1.0]
    held = list(draft.given["x"].values())[len(draft.given["x"]) - draft.n_held :]
    begin = [*casadi.vertsplit(draft.p)[len(draft.given["p"]) :], *(each.value for each in held)]
    start = column([*begin[:second], *[0.0] * (kept - second), *begin[second:], *[1.0] * has_clock])
    functions = contract_functions(
        motion,
        equations,
        everything,
        (draft.p, draft.d),
        (draft.derived, column(draft.start_by_name("u")), start),
        casadi.SX(1.0),
        column(scale),
        None if draft.iterated is draft.unsolved else (draft.unsolved, draft.iterated),
    )
    # numbers that move at a constant rate between events: of time and of states that only events change
    instants = [
        not casadi.depends_on(number, casadi.vertcat(draft.y[: n - 1], draft.v, draft.a, draft.u, draft.unsolved))
        and not casadi.depends_on(casadi.jacobian(number, draft.time), draft.time)
        for number in casadi.vertsplit(casadi.substitute(numbers, constant, casadi.SX.zeros(constant.numel())))
    ]
    if draft.events:
        functions = {**functions, **_event_functions(draft, numbers, motion)}
    zero_rates = casadi.substitute(casadi.jacobian(equations, motion.v), motion.v, casadi.SX.zeros(kept))
    return SymbolicModel(
        name=draft.name,
        description=draft.description or f"Model {draft.name}",
        unknowns=(*draft.given["q"], *draft.given["x"], *["time"] * has_clock),
        inputs=_variables(draft, "u", "input"),
        parameters=_parameters(draft),
        outputs=tuple(each for each, _ in shown),
        functions=functions,
        acceleration_terms=acceleration_terms(motion, everything),
        feedthrough=_feedthrough(draft, shown, equations, motion),
        static_start=False,
        margin_name="",
        minimum_margin=0.0,
        frictions=tuple(frictions),
        events=tuple(
            Event(first + 2 * len(draft.friction) + k, e.direction, e.reset is not None, instant, e.at_start, each)
            for k, ((each, e), instant) in enumerate(zip(draft.events.items(), instants, strict=True))
        ),
        is_damped=draft.n_first > 0 or casadi.sparsify(casadi.simplify(zero_rates)).nnz() > 0,
        first_order=draft.n_first,
        has_clock=has_clock,
        nominals=nominals,
    )


def _outputs(draft: Draft) -> Shown:
    """Coordinates and states with their time derivatives, variables of constraints, then the user's."""
    shown: Shown = []
    for k, (each, given) in enumerate((draft.given["q"] | draft.given["x"]).items()):
        levels = (draft.y, draft.v, draft.a) if k < draft.n_second else (draft.v, draft.a)
        unit, before = given.unit, None
        for name, level in zip((each, f"der({each})", f"der({each},2)"), levels, strict=False):
            text = f"Time derivative of {before}" if before else given.description or f"State {each}"
            shown.append((Variable(name, unit, text, "output", derivative_of=before), level[k]))
            unit, before = rate_unit(unit), name
    for (each, given), value in zip(draft.given["z"].items(), casadi.vertsplit(draft.solution), strict=True):
        text = given.description or f"Variable {each} of the constraints"
        shown.append((Variable(each, given.unit, text, "output", nominal=given.nominal), value))
    for each, given in draft.outputs.items():
        (value,) = draft.evaluated(f"output '{each}'", given.value, [each], switches=True)
        shown.append((_variable(each, given, "output", None), value))
    return shown


def _event_functions(draft: Draft, numbers: casadi.SX, motion: MotionSymbols) -> dict[str, casadi.Function]:
    """The numbers of the events with their rates, and the states behind them."""
    arguments, d = casadi.vertcat(motion.y, motion.v), draft.d
    rate = casadi.jtimes(numbers, arguments, casadi.vertcat(motion.v, motion.a))
    # which of [y, v] each name is
    n, second = motion.y.numel(), draft.n_second
    places = {each: k for k, each in enumerate(draft.given["q"])}
    places |= {f"der({each})": n + k for each, k in places.items()}
    places |= {each: n + second + k for k, each in enumerate(draft.given["x"])}
    fired, behind = casadi.SX.sym("fired", len(draft.events)), casadi.SX(arguments)
    for k, (each, entry) in enumerate(draft.events.items()):
        if entry.reset is None:
            continue
        what = f"reset of event '{each}'"
        found = draft.called(what, entry.reset, "qvxups") if callable(entry.reset) else entry.reset
        if not isinstance(found, Mapping) or not found or not found.keys() <= places.keys():
            raise ModelError(
                f"the {what} of model '{draft.name}' gives a dict of states, of {', '.join(places)}; got {found!r}"
            )
        values = draft.evaluated(what, found, list(found), switches=True)
        for name, value in zip(found, values, strict=True):
            behind[places[name]] += fired[k] * (value - arguments[places[name]])
    results = {
        "event_numbers": ([motion.y, motion.v, motion.a, motion.u, d], casadi.vertcat(numbers, rate)),
        "event_resets": ([motion.y, motion.v, motion.u, d, fired], behind),
    }
    return {
        name: casadi.Function(name, given, [casadi.densify(casadi.substitute(value, draft.unsolved, draft.iterated))])
        for name, (given, value) in results.items()
    }


def _definite(draft: Draft, residual: casadi.SX) -> casadi.SX:
    """The equations of second order, with the sign that makes the mass matrix positive definite.

    Raises:
        ModelError: they aren't linear in the accelerations, or the matrix isn't symmetric and definite at the start, or depends on
            rates.
    """
    if not draft.n_second:
        return casadi.SX(0, 1)
    names, what = list(draft.given["q"]), f"the mass matrix of model '{draft.name}'"
    mass = casadi.simplify(casadi.jacobian(residual, draft.a[: draft.n_second]))
    for symbols, text in (
        (draft.a, "accelerations; the residual must be linear in them"),
        (draft.v, "rates or states of first order"),
    ):
        if casadi.depends_on(mass, symbols):
            raise ModelError(f"{what}, the derivative of the residual by the accelerations, depends on {text}")
    moved = casadi.SX.sym("moved", draft.n_second)
    shifted = casadi.substitute(mass, draft.y[: draft.n_second], draft.y[: draft.n_second] + moved)
    masses = draft.at_start(casadi.densify(shifted), moved)
    # symmetric at the start, and at coordinates drawn around it
    for shift in (0.0 * np.ones(len(names)), *np.random.default_rng(0).uniform(-0.1, 0.1, (DRAWN, len(names)))):
        matrix = masses(shift).full()
        if not shift.any() and not np.isfinite(matrix).all():
            raise ModelError(f"{what} has entries that are no finite numbers at the start")
        sizes = np.sqrt(abs(np.outer(matrix.diagonal(), matrix.diagonal())))
        for i, j in zip(*np.nonzero(abs(matrix - matrix.T) > 1e-9 * np.maximum(abs(matrix), sizes)), strict=True):
            raise ModelError(
                f"{what} isn't symmetric{' away from the start' if shift.any() else ''}: its entry ({names[i]}, {names[j]}) is "
                f"{matrix[i, j]:.6g}, its entry ({names[j]}, {names[i]}) is {matrix[j, i]:.6g}; write the equations as those of "
                "Lagrange are, the one of a coordinate in its place"
            )
    matrix = masses(0.0).full()
    scale = 1.0 / np.sqrt(np.where(matrix.diagonal() == 0.0, 1.0, abs(matrix.diagonal())))
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    sign = 1.0 if values.sum() > 0.0 else -1.0
    least = int(np.argmin(sign * values))
    if sign * values[least] <= SINGULAR * abs(values).max() or not values.any():
        kind = "singular" if abs(values[least]) <= SINGULAR * max(abs(values).max(), 1e-300) else "not definite"
        worst = names[int(np.argmax(abs(vectors[:, least])))]
        raise ModelError(
            f"{what} is {kind} at the start: '{worst}' has no inertia of its own; give it some, or make it a state x"
        )
    return sign * residual


def _nominals(draft: Draft) -> tuple[float, ...]:
    """Usual sizes of the states: coordinates, rates, states of first order."""
    q, rates = draft.given["q"], draft.given["rates"]
    moving = {each: given for each, given in rates.items() if given.nominal or given.value}
    return tuple(each.size for each in (*q.values(), *(q | moving).values(), *draft.given["x"].values()))


def _variable(name: str, given: variable, causality: Causality, start: Any) -> Variable:
    """A user's entry as a variable of the FMU."""
    text = given.description or f"{causality.capitalize()} {name}"
    return Variable(name, given.unit, text, causality, start, given.minimum, given.maximum, given.nominal)


def _variables(draft: Draft, letter: str, causality: Causality) -> tuple[Variable, ...]:
    """The user's inputs or parameters."""
    return tuple(_variable(name, given, causality, given.value) for name, given in draft.given[letter].items())


def _parameters(draft: Draft) -> tuple[Variable, ...]:
    """The user's parameters, and the start of every state."""
    q, x = draft.given["q"], draft.given["x"]
    starts = [(f"start.{each}", g.unit, f"Start of {each}", g.value) for each, g in q.items()]
    starts += [
        (f"start_rate.{each}", rate_unit(given.unit), f"Rate of {each} at the start", rate)
        for (each, given), rate in zip(q.items(), draft.start_by_name("rates"), strict=True)
    ]
    starts += [
        (f"start.{each}", x[each].unit, f"Start of {each}", x[each].value) for each in [*x][: len(x) - draft.n_held]
    ]
    return (
        *_variables(draft, "p", "parameter"),
        *(Variable(name, unit, text, "parameter", start=value) for name, unit, text, value in starts),
    )


def _feedthrough(draft: Draft, shown: Shown, residual: casadi.SX, motion: MotionSymbols) -> dict[str, tuple[str, ...]]:
    """Output → inputs that it depends on, directly or through accelerations."""
    names = list(draft.given["u"])
    mass, load = casadi.jacobian_sparsity(residual, motion.a), casadi.jacobian_sparsity(residual, motion.u)
    by_row: list[set[int]] = [set() for _ in range(residual.numel())]
    for row, place in zip(*load.get_triplet(), strict=True):
        by_row[row].add(place)
    # coupled accelerations depend on the inputs of all equations of second order
    if not mass.is_diag():
        coupled = set().union(*by_row[: draft.n_second])
        by_row[: draft.n_second] = [coupled] * draft.n_second
    found = {}
    for each, value in shown:
        inputs = set(casadi.jacobian_sparsity(value, motion.u).get_triplet()[1])
        for k in casadi.jacobian_sparsity(value, motion.a).get_triplet()[1]:
            inputs |= by_row[k]
        found[each.name] = tuple(names[k] for k in sorted(inputs))
    return found
