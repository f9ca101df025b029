"""Models from a user's equations as `SymbolicModel`: states of first order, coordinates of second order, Lagrange's equations, and
constraints that determine further variables (semi-explicit differential-algebraic equations of index 1).

Equations are functions of named symbols, or CasADi expressions of symbols with these names. A function takes any of the arguments
``q``, ``v``, ``a`` (coordinates, their rates and accelerations), ``x`` (states of first order), ``z`` (variables of constraints), ``u``
(inputs), ``p`` (parameters, derived ones too), ``s`` (sides of events) and ``t`` (time [s])::

    vdp = ode("vdp", x={"x0": 2.0, "x1": 0.0}, p={"mu": 1.0}, rhs=lambda x, p: [x.x1, p.mu * (1 - x.x0**2) * x.x1 - x.x0])

Constraints that are linear in z are solved as they stand. Others are solved by three of Newton's iterations from a guess, a further
state that follows the solution; where these don't converge the equations give no number, and the integrator takes shorter steps.
"""

from __future__ import annotations

import inspect
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from math import isfinite
from typing import Any

import casadi
import numpy as np

from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.interface import find_states
from flexfmu.fmu_build.units import unit_exponents
from flexfmu.model.contract import Linearisation, LinearPlant, contract_functions
from flexfmu.model.symbolic import Causality, Event, Friction, SymbolicModel, Variable
from flexfmu.model.time_derivatives import MotionSymbols, acceleration_terms

Equation = Any
"""A function of named symbols, or expressions: one, a list in order, or a dict by name."""

SWITCHES = {
    getattr(casadi, f"OP_{name}"): text
    for name, text in {
        "LT": "<",
        "LE": "<=",
        "EQ": "==",
        "NE": "!=",
        "NOT": "not",
        "AND": "and",
        "OR": "or",
        "IF_ELSE_ZERO": "if_else",
        "SIGN": "sign",
        "FLOOR": "floor",
        "CEIL": "ceil",
        "FMOD": "fmod",
        "COPYSIGN": "copysign",
    }.items()
}
"""Operations whose results jump; an integrator that steps over a jump loses its accuracy there."""

SINGULAR = 1e-12
"""Ratio of the singular values of a matrix that counts as singular."""

RELAXATION = 1e4
"""Rate [1/s] at which the guess of a nonlinear constraint's solution follows it; far above the motions of most models."""

CONVERGED = 1e-4
"""Largest last correction of Newton's iterations relative to the size of z: the error that it leaves is about its square."""

DRAWN = 3
"""Number of points at which the symmetry of a mass matrix is checked beside the start."""

ITERATIONS, START_ITERATIONS = 3, 50
"""Newton iterations for constraints, in every evaluation of the equations and at the start."""


@dataclass(frozen=True)
class variable:  # noqa: N801 - written by users as a call
    """A state, input or parameter with more than its start value, or an output with more than its equation.

        flexfmu.variable(0.05, "rad", nominal=1.0)

    Args:
        value: start value in ``unit``, or an output's function or expression.
        unit: such as ``N.m`` or ``rad/s2``; ``1`` for none.
        nominal: usual size in ``unit``, above zero; None for the size of the start value, or 1 where that is zero. The tolerance is
            relative to the nominal, or to the largest value that a state has had.
        minimum, maximum: admissible range in ``unit`` of a parameter or input.
        description: one sentence.

    Raises:
        ModelError: the unit is unknown.
    """

    value: Any
    unit: str = "1"
    _: KW_ONLY
    nominal: float | None = None
    minimum: float | None = None
    maximum: float | None = None
    description: str = ""

    def __post_init__(self) -> None:
        unit_exponents(self.unit)


@dataclass(frozen=True)
class event:  # noqa: N801 - written by users as a call
    """An event: the passage of a number through zero, at which the equations see another side, or states are reset.

        bounce = flexfmu.event(lambda q: q.height, -1, lambda v, p: {"der(height)": -p.restitution * v.height})

    Args:
        number: function of q, v, x, u, p and t, of the size of 1; of time alone for an instant. Equations have its sign, 1 or -1, as
            ``s.NAME``.
        direction: of the passages that reset states: 1 upwards, -1 downwards, 0 both.
        reset: states behind the event by name, a function that gives a dict; others stay.

    Raises:
        ModelError: the direction is none of these.
    """

    number: Equation
    direction: int = 0
    reset: Equation = None

    def __post_init__(self) -> None:
        if self.direction not in (-1, 0, 1):
            raise ModelError(
                f"the direction of an event is 1 (upwards), -1 (downwards) or 0 (both), got {self.direction!r}"
            )


class Names:
    """Symbols by name, ``x.x1`` or ``x["arm.angle"]``; iterating gives them in their order."""

    def __init__(self, what: str, symbols: Mapping[str, casadi.SX]) -> None:
        self._what, self._symbols = what, symbols

    def __getattr__(self, name: str) -> casadi.SX:
        """The symbol with this name."""
        if name.startswith("__"):
            raise AttributeError(name)
        return self[name]

    def __getitem__(self, name: str) -> casadi.SX:
        """The symbol with this name.

        Raises:
            ModelError: there is none.
        """
        if name not in self._symbols:
            raise ModelError(f"{self._what} has no '{name}'; it has {', '.join(self._symbols) or 'none'}")
        return self._symbols[name]

    def __iter__(self) -> Iterator[casadi.SX]:
        """The symbols in their order."""
        return iter(self._symbols.values())

    def __len__(self) -> int:
        """Number of symbols."""
        return len(self._symbols)


def ode(
    name: str,
    *,
    x: Mapping[str, Any],
    rhs: Equation,
    u: Mapping[str, Any] | None = None,
    p: Mapping[str, Any] | None = None,
    derived: Mapping[str, Equation] | None = None,
    outputs: Mapping[str, Equation] | None = None,
    events: Mapping[str, event] | None = None,
    description: str = "",
) -> SymbolicModel:
    """A model of first order: x' = rhs(x, u, p, t).

    Args:
        name: name of the model.
        x: state → start value, a number or `variable`; the FMU has it as parameter ``start.NAME`` too.
        rhs: the states' time derivatives, a function of x, u, p and t.
        u, p: input, parameter → start value.
        derived: derived parameter → function of p, computed once; it belongs to p.
        outputs: further output → function of x, u, p and t; the states and their derivatives, ``der(NAME)``, are outputs anyway.
        events: event → `event`; equations and outputs may take ``s``, the sides.
        description: one sentence.

    Raises:
        ModelError: an equation, a name, a start value or a unit is wrong.
    """
    model = _Draft(name, {}, {}, x, {}, u, p, derived, events)
    return model.finished([], model.evaluated("rhs", rhs, list(x)), outputs, description)


def second_order(
    name: str,
    *,
    q: Mapping[str, Any],
    residual: Equation,
    rates: Mapping[str, Any] | None = None,
    x: Mapping[str, Any] | None = None,
    rhs: Equation = (),
    u: Mapping[str, Any] | None = None,
    p: Mapping[str, Any] | None = None,
    derived: Mapping[str, Equation] | None = None,
    outputs: Mapping[str, Equation] | None = None,
    events: Mapping[str, event] | None = None,
    friction: Mapping[str, Equation] | None = None,
    description: str = "",
) -> SymbolicModel:
    """A model of second order: residual(q, v, a, u, p, t) = M(q, u, p, t) a + b(q, v, u, p, t) = 0, one equation for each coordinate.

    M, the derivative of the residual by the accelerations, must be symmetric and definite, as that of Lagrange's equations is.

    Args:
        name: name of the model.
        q: coordinate → start value, a number or `variable`.
        residual: the equations, a function of q, v, a, u, p, x and t, in the order of q or by coordinate.
        rates: coordinate → its rate at the start; zero for others.
        x, rhs: states of first order beside the coordinates, as of an actuator, and their time derivatives; M may not depend on them.
        u, p, derived, outputs, events, description: as for `ode`; the coordinates with their rates ``der(NAME)`` and accelerations
            ``der(NAME,2)`` are outputs anyway.
        friction: coordinate → breakaway force of its dry friction, a number or function of p, or a pair of it and the force while it slips,
            a function of q, v and p. It sticks where it can, and events switch to slip and back.

    Raises:
        ModelError: an equation, a name, a start value or a unit is wrong, or M isn't symmetric and definite.
    """
    model = _Draft(name, q, rates or {}, x or {}, {}, u, p, derived, events, friction)
    equations = model.evaluated("residual", residual, list(q))
    return model.finished(equations, model.evaluated("rhs", rhs, list(x or {})), outputs, description)


def lagrangian(
    name: str,
    *,
    q: Mapping[str, Any],
    kinetic: Equation,
    potential: Equation = 0.0,
    dissipation: Equation = 0.0,
    forces: Equation = None,
    rates: Mapping[str, Any] | None = None,
    x: Mapping[str, Any] | None = None,
    rhs: Equation = (),
    u: Mapping[str, Any] | None = None,
    p: Mapping[str, Any] | None = None,
    derived: Mapping[str, Equation] | None = None,
    outputs: Mapping[str, Equation] | None = None,
    events: Mapping[str, event] | None = None,
    friction: Mapping[str, Equation] | None = None,
    description: str = "",
) -> SymbolicModel:
    """A model from its energies, by Lagrange's equations d/dt dT/dv - d(T - V)/dq + dR/dv = Q.

    Args:
        name: name of the model.
        q: coordinate → start value, a number or `variable`.
        kinetic: kinetic energy T [J], a function of q, v, p and t.
        potential: potential energy V [J], a function of q, p, u and t.
        dissipation: Rayleigh's function R [W], half of the power that dampers take, a function of q, v and p.
        forces: generalised forces Q, a function of q, v, u, p, x and t, in the order of q, or by coordinate with zero for others.
        rates, x, rhs, u, p, derived, outputs, events, friction, description: as for `second_order`.

    Raises:
        ModelError: as for `second_order`.
    """
    model = _Draft(name, q, rates or {}, x or {}, {}, u, p, derived, events, friction)
    (t_energy,), (v_energy,), (rayleigh,) = (
        model.evaluated(what, source, [what])
        for what, source in (("kinetic", kinetic), ("potential", potential), ("dissipation", dissipation))
    )
    applied = model.evaluated("forces", {} if forces is None else forces, list(q), missing=0.0)
    # d/dt along the motion: q changes by v, v by a, time by 1
    n, y, v, a = len(q), model.y, model.v, model.a
    moved, rate = casadi.vertcat(y[:n], v[:n], model.time), casadi.vertcat(v[:n], a[:n], 1)
    momentum = casadi.gradient(t_energy, v[:n])
    equations = casadi.jtimes(momentum, moved, rate) - casadi.gradient(t_energy - v_energy, y[:n])
    equations += casadi.gradient(rayleigh, v[:n]) - casadi.vertcat(*applied)
    return model.finished(casadi.vertsplit(equations), model.evaluated("rhs", rhs, list(x or {})), outputs, description)


def dae(
    name: str,
    *,
    x: Mapping[str, Any],
    z: Mapping[str, Any],
    rhs: Equation,
    constraints: Equation,
    u: Mapping[str, Any] | None = None,
    p: Mapping[str, Any] | None = None,
    derived: Mapping[str, Equation] | None = None,
    outputs: Mapping[str, Equation] | None = None,
    events: Mapping[str, event] | None = None,
    description: str = "",
) -> SymbolicModel:
    """A model with constraints: x' = rhs(x, z, u, p, t), 0 = constraints(x, z, u, p, t), of index 1: they determine z.

    Args:
        name: name of the model.
        x: state → start value, a number or `variable`.
        z: variable that the constraints determine → guess of its value at the start; it is an output.
        rhs, constraints: functions of x, z, u, p and t.
        u, p, derived, outputs, events, description: as for `ode`; outputs may depend on z.

    Raises:
        ModelError: as for `ode`, or the constraints don't determine z, as where the index is 2 or 3.
    """
    draft = _Draft(name, {}, {}, x, z, u, p, derived, events)
    constrained = draft.evaluated("constraints", constraints, [f"0 ({each})" for each in z])
    unknowns, defect = casadi.vertcat(*draft.scopes["z"]), casadi.vertcat(*constrained)
    slope = casadi.jacobian(defect, unknowns)
    guess = draft.solved_start(z, defect, slope)
    if not casadi.depends_on(slope, unknowns):
        solution = casadi.solve(slope, -casadi.substitute(defect, unknowns, casadi.SX.zeros(len(z))))
        return draft.with_solution(solution).finished(
            [], draft.with_solution(solution).evaluated("rhs", rhs, list(x)), outputs, description
        )
    # further states that follow the solution, from which Newton's method starts
    follows = {f"guess.{each}": replace(_declared("z", each, z[each]), value=value) for each, value in guess.items()}
    draft = _Draft(name, {}, {}, {**x, **follows}, z, u, p, derived, events)
    constrained = draft.evaluated("constraints", constraints, [f"0 ({each})" for each in z])
    unknowns, defect = casadi.vertcat(*draft.scopes["z"]), casadi.vertcat(*constrained)
    correction = casadi.solve(casadi.jacobian(defect, unknowns), -defect)
    guesses = casadi.vertcat(*(draft.scopes["x"][each] for each in follows))
    solution = guesses
    for _ in range(ITERATIONS):
        step = casadi.substitute(correction, unknowns, solution)
        solution = solution + step
    sizes = casadi.vertcat(*(each.nominal or abs(each.value) or 1.0 for each in follows.values()))
    # the root of a negative number is no number, where the last correction is too large
    distance = casadi.sumsqr(step / (CONVERGED * (sizes + casadi.fabs(solution))))
    gate = 1e-300 * casadi.sqrt(1 - distance)
    model = draft.with_solution(solution)
    rates = [each + gate for each in model.evaluated("rhs", rhs, list(x))]
    return model.finished([], [*rates, *casadi.vertsplit(RELAXATION * (solution - guesses))], outputs, description)


_PART = r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?"


def _check_name(name: Any) -> None:
    """Check that the name of a variable is a structured one of FMI.

    Raises:
        ModelError: it isn't.
    """
    if not isinstance(name, str) or not re.fullmatch(rf"{_PART}(\.{_PART})*", name, re.ASCII):
        raise ModelError(f"{name!r} can't be the name of a variable; write it like angle, arm.angle or temperature[1]")


def _declared(scope: str, name: str, value: Any) -> variable:
    """A user's entry with its numbers checked.

    Raises:
        ModelError: a number isn't finite, the nominal value isn't positive, the range is empty, or the unit or name is unknown.
    """
    given = value if isinstance(value, variable) else variable(value)
    _check_name(name)

    def number(what: str, entry: Any) -> float:
        try:
            found = float(entry)
        except (TypeError, ValueError, RuntimeError):
            raise ModelError(f"{what} of {scope} '{name}' must be a number, got {entry!r}") from None
        if not isfinite(found) or (what == "nominal" and found <= 0.0):
            kind = "positive" if what == "nominal" else "finite"
            raise ModelError(f"{what} of {scope} '{name}' must be a {kind} number, got {found} {given.unit}")
        return found

    nominal, low, high = (
        None if (entry := getattr(given, what)) is None else number(what, entry)
        for what in ("nominal", "minimum", "maximum")
    )
    return replace(given, value=number("start", given.value), nominal=nominal, minimum=low, maximum=high)


def rate_unit(unit: str) -> str:
    """Unit of a time derivative: ``m`` → ``m/s``, ``m/s`` → ``m/s2``."""
    head, slash, power = unit.rpartition("/s")
    if slash and (power == "" or power.isdigit()):
        return f"{head}/s{int(power or 1) + 1}"
    return f"{unit[:-1]}.s)" if unit.endswith(")") else f"{unit}/s"


def _column(entries: Sequence[Any]) -> casadi.SX:
    """A column of scalars, of none too; CasADi's slices of a single number are rows."""
    return casadi.vertcat(casadi.SX(0, 1), *entries)


class _Draft:
    """The symbols of a model, and its equations as expressions of them.

    Attributes:
        y, v, a: symbols of all unknowns: coordinates of second order, of first order, time.
        time: symbol of the time.
        scopes: argument of a user's function → what it gets.
    """

    def __init__(
        self,
        name: str,
        q: Mapping[str, Any],
        rates: Mapping[str, Any],
        x: Mapping[str, Any],
        z: Mapping[str, Any],
        u: Mapping[str, Any] | None,
        p: Mapping[str, Any] | None,
        derived: Mapping[str, Equation] | None,
        events: Mapping[str, event] | None,
        friction: Mapping[str, Equation] | None = None,
    ) -> None:
        if not isinstance(name, str) or not name:
            raise ModelError(f"the name of a model is a text, got {name!r}")
        self.name = name
        given = {"q": q, "rates": rates, "x": x, "z": z, "u": u or {}, "p": p or {}}
        for scope, entries in given.items():
            if not isinstance(entries, Mapping):
                raise ModelError(f"{scope} of model '{name}' is a dict from names to start values, got {entries!r}")
        if not q and not x:
            raise ModelError(f"model '{name}' has no states; give at least one")
        self.given = {s: {each: _declared(s, each, entries[each]) for each in entries} for s, entries in given.items()}
        names = Counter([*q, *x, *z, *given["u"], *given["p"], *(derived or {}), *(events or {})])
        for each in names:
            _check_name(each)
        if twice := [each for each, count in names.items() if count > 1]:
            raise ModelError(f"model '{name}' has the name '{twice[0]}' more than once; names must be unique")
        if unknown := rates.keys() - q.keys():
            raise ModelError(
                f"rates of model '{name}' name '{min(unknown)}', which is no coordinate; these are {', '.join(q)}"
            )
        self.n_second, self.n_first = len(q), len(x)
        # unknowns, of which time is the last
        n = self.n_second + self.n_first + 1
        self.y, self.v, self.a = (casadi.SX.sym(letter, n) for letter in "yva")
        self.events = dict(events or {})
        if wrong := [each for each, entry in self.events.items() if not isinstance(entry, event)]:
            raise ModelError(f"event '{wrong[0]}' of model '{name}' must be made by flexfmu.event")
        self.friction = {each: f if isinstance(f, tuple) else (f, f) for each, f in (friction or {}).items()}
        if wrong := [each for each, pair in self.friction.items() if each not in q or len(pair) != 2]:
            raise ModelError(f"friction of model '{name}' is coordinate → force, or a pair of forces, got '{wrong[0]}'")
        # constants, breakaway forces and directions of friction, sides of events
        derived = dict(derived or {})
        constants = len(given["p"]) + len(derived)
        derived |= {f"friction.{each}": pair[0] for each, pair in self.friction.items()}
        self.u = casadi.SX.sym("u", len(given["u"]))
        self.d = casadi.SX.sym("d", constants + 2 * len(self.friction) + len(self.events))
        self.time = self.y[n - 1]
        unsolved = casadi.SX.sym("z", len(z))

        def named(letter: str, names: Sequence[str], symbols: casadi.SX) -> Names:
            return Names(f"{letter} of model '{name}'", dict(zip(names, casadi.vertsplit(symbols), strict=True)))

        second = slice(0, self.n_second)
        self.scopes: dict[str, Any] = {
            "q": named("q", list(q), self.y[second]),
            "v": named("v", list(q), self.v[second]),
            "a": named("a", list(q), self.a[second]),
            "x": named("x", list(x), self.v[self.n_second : n - 1]),
            "z": named("z", list(z), unsolved),
            "u": named("u", list(given["u"]), self.u),
            "p": named("p", [*given["p"], *derived][:constants], _column(casadi.vertsplit(self.d)[:constants])),
            "s": named("s", list(self.events), _column(casadi.vertsplit(self.d)[constants + 2 * len(self.friction) :])),
            "t": self.time,
        }
        # derived parameters as expressions of the others, which come first
        self.p = casadi.SX.sym("p", len(given["p"]) + len(q) * 2 + len(x))
        self.derived = _column(casadi.vertsplit(self.p)[: len(given["p"])])
        for each, source in derived.items():
            (value,) = self.evaluated(f"derived parameter '{each}'", source, [each], scopes="p", switches=True)
            value = casadi.substitute(value, _column(casadi.vertsplit(self.d)[: self.derived.numel()]), self.derived)
            if casadi.depends_on(value, self.d):
                raise ModelError(
                    f"derived parameter '{each}' of model '{name}' needs one that comes later; change their order"
                )
            self.derived = casadi.vertcat(self.derived, value)
        self.derived = _column([*casadi.vertsplit(self.derived), *[0.0] * (len(self.friction) + len(self.events))])

    def with_solution(self, solution: casadi.SX) -> _Draft:
        """Put the solution of the constraints in the place of z."""
        names = list(self.given["z"])
        self.scopes["z"] = Names(f"z of model '{self.name}'", dict(zip(names, casadi.vertsplit(solution), strict=True)))
        return self

    def evaluated(
        self,
        what: str,
        source: Equation,
        names: Sequence[str],
        *,
        missing: float | None = None,
        scopes: str = "qvaxzupts",
        switches: bool = False,
    ) -> list[casadi.SX]:
        """The expressions of an equation, one for each name.

        Args:
            what: name of the equation in messages.
            source: the equation.
            names: what it gives.
            missing: value of names that a dict leaves out; None if it must have all.
            scopes: arguments that a function may take.
            switches: whether results may jump.

        Raises:
            ModelError: it fails, gives something else, has free symbols or jumps.
        """
        where = what if what.startswith("derived") else f"{what} of model '{self.name}'"
        where = where if self.name in where else f"{where} of model '{self.name}'"
        found = self._called(where, source, scopes) if callable(source) else source
        if isinstance(found, Mapping):
            if unknown := [each for each in found if each not in names]:
                raise ModelError(f"{where} gives {unknown[0]!r}, which isn't among {', '.join(names)}")
            lacking = [each for each in names if each not in found]
            if lacking and missing is None:
                raise ModelError(f"{where} gives nothing for '{lacking[0]}'")
            found = [found.get(each, missing) for each in names]
        elif isinstance(found, casadi.SX | casadi.DM):
            found = casadi.vertsplit(casadi.SX(found))
        elif isinstance(found, str) or not isinstance(found, Sequence | np.ndarray):
            found = [found]
        if len(found) != len(names):
            raise ModelError(f"{where} gives {len(found)} expressions, but must give {len(names)}: {', '.join(names)}")
        return [
            self._checked(f"{where}, {each}", value, scopes, switches) for each, value in zip(names, found, strict=True)
        ]

    def _called(self, where: str, source: Callable[..., Any], scopes: str) -> Any:
        """What a user's function gives."""
        wanted = list(inspect.signature(source).parameters)
        if unknown := [each for each in wanted if each not in set(scopes)]:
            raise ModelError(f"the function of {where} takes '{unknown[0]}'; it may take {', '.join(scopes)}")
        try:
            return source(**{each: self.scopes[each] for each in wanted})
        except ModelError:
            raise
        except Exception as error:
            if "truth value" in str(error):
                raise ModelError(
                    f"{where} compares symbols in Python (if, max, and); make the switch an event and use its side, or make it smooth"
                ) from error
            reason = str(error).strip().splitlines()
            raise ModelError(f"{where}: {type(error).__name__}{f': {reason[-1]}' if reason else ''}") from error

    def _checked(self, where: str, value: Any, scopes: str, switches: bool) -> casadi.SX:
        """A scalar expression of the model's symbols."""
        try:
            expression = casadi.SX(value)
        except (TypeError, NotImplementedError, RuntimeError):
            kind = "a CasADi MX; use SX" if isinstance(value, casadi.MX) else repr(value)
            raise ModelError(f"{where} must be a number or an expression, got {kind}") from None
        if expression.numel() != 1:
            raise ModelError(f"{where} must be one expression, got {expression.size1()} x {expression.size2()} of them")
        # symbols of the user by name; those of the model are known
        own = {each.element_hash() for each in casadi.symvar(casadi.vertcat(self.y, self.v, self.a, self.u, self.d))}
        own |= {each.element_hash() for each in casadi.symvar(_column([*self.scopes["z"]]))}
        named: dict[str, casadi.SX] = {"t": self.time} if "t" in scopes else {}
        for letter in (each for each in scopes if each not in "vats"):
            named |= self.scopes[letter]._symbols
        if "v" in scopes:
            named |= {f"der({each})": symbol for each, symbol in self.scopes["v"]._symbols.items()}
            named |= {f"der({each},2)": symbol for each, symbol in self.scopes["a"]._symbols.items()}
        for symbol in casadi.symvar(expression):
            if symbol.element_hash() in own:
                continue
            if symbol.name() not in named:
                raise ModelError(f"{where} has the free symbol '{symbol.name()}'; the model has {', '.join(named)}")
            expression = casadi.substitute(expression, symbol, named[symbol.name()])
        # numbers, and operations that jump
        function = casadi.Function("f", casadi.symvar(expression), [expression])
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            if operation == casadi.OP_CONST and not isfinite(function.instruction_constant(k)):
                raise ModelError(
                    f"{where} has the number {function.instruction_constant(k)}, which isn't finite; functions of symbols are CasADi's, as "
                    "casadi.sin, not those of math"
                )
            if operation in SWITCHES and not switches:
                raise ModelError(
                    f"{where} jumps ({SWITCHES[operation]}), which no integrator steps over accurately; make it smooth, with tanh for "
                    "example, make the switch an event and use its side, or put what depends on parameters alone into derived"
                )
        return casadi.densify(expression)

    def _at_start(self, expression: casadi.SX, unknowns: casadi.SX) -> casadi.Function:
        """An expression at the start, as a function of some of its symbols."""
        q, rates, x, u = (self._start_by_name(letter) for letter in ("q", "rates", "x", "u"))
        parameters = self._parameter_values()
        derived = casadi.Function("d", [self.p], [self.derived])(parameters)
        y, v = [*q, *[0.0] * self.n_first, 0.0], [*rates, *x, 1.0]
        symbols = casadi.vertcat(self.y, self.v, self.u, self.d)
        at = casadi.substitute(expression, symbols, casadi.vertcat(*y, *v, *u, derived))
        return casadi.Function("start", [unknowns], [at])

    def _start_by_name(self, letter: str) -> list[float]:
        """Start values in the order of the symbols; rates that aren't given are zero."""
        if letter == "rates":
            return [self.given["rates"][each].value if each in self.given["rates"] else 0.0 for each in self.given["q"]]
        return [each.value for each in self.given[letter].values()]

    def _parameter_values(self) -> list[float]:
        return [value for letter in ("p", "q", "rates", "x") for value in self._start_by_name(letter)]

    def solved_start(self, z: Mapping[str, Any], defect: casadi.SX, slope: casadi.SX) -> dict[str, float]:
        """The solution of the constraints at the start.

        Raises:
            ModelError: they don't determine z, or Newton's method doesn't converge.
        """
        names, unknowns = list(z), casadi.vertcat(*self.scopes["z"])
        function = self._at_start(casadi.horzcat(defect, slope), unknowns)
        value = np.array([each.value for each in self.given["z"].values()])
        for _ in range(START_ITERATIONS):
            both = function(value).full()
            residual, matrix = both[:, 0], both[:, 1:]
            if not np.isfinite(both).all():
                break
            left, sizes, right = np.linalg.svd(matrix)
            if sizes[-1] <= SINGULAR * max(sizes[0], 1e-300):
                remedy = "give another guess in z; or " if casadi.depends_on(slope, unknowns) else ""
                raise ModelError(
                    f"the constraints of model '{self.name}' don't determine '{names[int(np.argmax(abs(right[-1])))]}' (constraint "
                    f"{int(np.argmax(abs(left[:, -1]))) + 1} doesn't change with it): {remedy}the index is 2 or 3; differentiate that "
                    "constraint by time until it holds the variable, or take second_order or lagrangian with coordinates that fulfil it"
                )
            step = np.linalg.solve(matrix, residual)
            value = value - step
            if (abs(step) <= 1e-10 * (1.0 + abs(value))).all():
                return dict(zip(names, value.tolist(), strict=True))
        guess = ", ".join(f"{each} = {given.value:g}" for each, given in self.given["z"].items())
        raise ModelError(
            f"the constraints of model '{self.name}' can't be solved at the start from the guess {guess}; give a better one in z"
        )

    def finished(
        self, residual: list[casadi.SX], rhs: list[casadi.SX], outputs: Mapping[str, Equation] | None, description: str
    ) -> SymbolicModel:
        """The model with these equations of second and first order.

        Raises:
            ModelError: an output is wrong, or the mass matrix isn't symmetric and definite.
        """
        n, second = self.y.numel(), self.n_second
        equations = self._definite(_column(residual))
        # friction acts against the direction of slip, on the equations with a positive mass matrix
        frictions, first = [], self.d.numel() - len(self.events) - 2 * len(self.friction)
        for k, (each, (_, slip)) in enumerate(self.friction.items()):
            found = Friction(list(self.given["q"]).index(each), first + k, first + len(self.friction) + k)
            (force,) = self.evaluated(f"friction of '{each}'", slip, [each], scopes="qvp")
            equations[found.unknown] += self.d[found.direction] * force
            frictions.append(found)
        equations = casadi.vertcat(equations, self.a[second : n - 1] - _column(rhs), self.a[n - 1])
        # outputs: coordinates and states with their time derivatives, variables of constraints, then the user's
        shown: list[tuple[Variable, casadi.SX]] = []
        for k, (each, given) in enumerate((self.given["q"] | self.given["x"]).items()):
            levels = (self.y, self.v, self.a) if k < second else (self.v, self.a)
            names = [each, f"der({each})", f"der({each},2)"][: len(levels)]
            unit, before = given.unit, None
            for name, level in zip(names, levels, strict=True):
                text = given.description or f"State {each}"
                text = text if before is None else f"Time derivative of {before}"
                shown.append((Variable(name, unit, text, "output", derivative_of=before), level[k]))
                unit, before = rate_unit(unit), name
        for each, given in self.given["z"].items():
            text = given.description or f"Variable {each} of the constraints"
            shown.append((Variable(each, given.unit, text, "output", nominal=given.nominal), self.scopes["z"][each]))
        for each, source in (outputs or {}).items():
            _check_name(each)
            given = source if isinstance(source, variable) else variable(source)
            (value,) = self.evaluated(f"output '{each}'", given.value, [each], switches=True)
            text = given.description or f"Output {each}"
            shown.append(
                (Variable(each, given.unit, text, "output", None, given.minimum, given.maximum, given.nominal), value)
            )
        everything = casadi.vertcat(*(value for _, value in shown))
        # the clock is there where something depends on it
        numbers = [self.evaluated(f"event '{each}'", e.number, [each])[0] for each, e in self.events.items()]
        self.numbers = _column(numbers)
        has_clock = casadi.depends_on(casadi.vertcat(equations, everything, self.numbers), self.time)
        kept = n if has_clock else n - 1
        motion = MotionSymbols(self.y[:kept], self.v[:kept], self.a[:kept], self.u)
        equations, entries = equations[:kept], self.given["q"] | self.given["x"]
        nominals = self._nominals()
        weights = [1 / each**2 for each in nominals]
        scale = [*weights[:second], *[0.0] * (kept - second), *weights[second:], *[0.0] * has_clock, 1.0]
        begin = casadi.vertsplit(self.p)[len(self.given["p"]) :]
        start = _column([*begin[:second], *[0.0] * (kept - second), *begin[second:], *[1.0] * has_clock])
        functions = contract_functions(
            motion,
            equations,
            everything,
            (self.p, self.d),
            (self.derived, _column(self._start_by_name("u")), start),
            casadi.SX(1.0),
            _column(scale),
        )
        if self.events:
            functions = {**functions, **self._event_functions(motion)}
        zero_rates = casadi.substitute(casadi.jacobian(equations, motion.v), motion.v, casadi.SX.zeros(kept))
        return SymbolicModel(
            name=self.name,
            description=description or f"Model {self.name}",
            unknowns=(*entries, *["time"] * has_clock),
            inputs=self._variables("u", "input"),
            parameters=self._parameters(),
            outputs=tuple(each for each, _ in shown),
            functions=functions,
            acceleration_terms=acceleration_terms(motion, everything),
            feedthrough=self._feedthrough(shown, equations, motion),
            static_start=False,
            margin_name="",
            minimum_margin=0.0,
            frictions=tuple(frictions),
            events=tuple(
                Event(self.d.numel() - len(self.events) + k, each.direction, each.reset is not None)
                for k, each in enumerate(self.events.values())
            ),
            is_damped=self.n_first > 0 or casadi.sparsify(casadi.simplify(zero_rates)).nnz() > 0,
            first_order=self.n_first,
            has_clock=has_clock,
            nominals=nominals,
        )

    def _event_functions(self, motion: MotionSymbols) -> dict[str, casadi.Function]:
        """The numbers of the events with their rates, and the states behind them."""
        arguments = casadi.vertcat(motion.y, motion.v)
        rate = casadi.jtimes(self.numbers, arguments, casadi.vertcat(motion.v, motion.a))
        # which of [y, v] each name is
        coordinates, states = list(self.given["q"]), list(self.given["x"])
        n, second = motion.y.numel(), self.n_second
        places = {each: k for k, each in enumerate(coordinates)}
        places |= {f"der({each})": n + k for k, each in enumerate(coordinates)}
        places |= {each: n + second + k for k, each in enumerate(states)}
        fired, behind = casadi.SX.sym("fired", len(self.events)), casadi.SX(arguments)
        for k, (each, entry) in enumerate(self.events.items()):
            if entry.reset is None:
                continue
            found = (
                self._called(f"reset of event '{each}'", entry.reset, "qvxups")
                if callable(entry.reset)
                else entry.reset
            )
            if not isinstance(found, Mapping) or not found or not found.keys() <= places.keys():
                raise ModelError(
                    f"the reset of event '{each}' of model '{self.name}' gives a dict of states, of {', '.join(places)}; got {found!r}"
                )
            values = self.evaluated(f"reset of event '{each}'", found, list(found), switches=True)
            for name, value in zip(found, values, strict=True):
                behind[places[name]] += fired[k] * (value - arguments[places[name]])
        d = self.d
        return {
            "event_numbers": casadi.Function(
                "event_numbers",
                [motion.y, motion.v, motion.a, motion.u, d],
                [casadi.densify(casadi.vertcat(self.numbers, rate))],
            ),
            "event_resets": casadi.Function(
                "event_resets", [motion.y, motion.v, motion.u, d, fired], [casadi.densify(behind)]
            ),
        }

    def _definite(self, residual: casadi.SX) -> casadi.SX:
        """The equations of second order, with the sign that makes the mass matrix positive definite.

        Raises:
            ModelError: they aren't linear in the accelerations, or the matrix isn't symmetric and definite at the start, or depends on
                rates.
        """
        if not self.n_second:
            return casadi.SX(0, 1)
        names, what = list(self.given["q"]), f"the mass matrix of model '{self.name}'"
        mass = casadi.simplify(casadi.jacobian(residual, self.a[: self.n_second]))
        for symbols, text in (
            (self.a, "accelerations; the residual must be linear in them"),
            (self.v, "rates or states of first order"),
        ):
            if casadi.depends_on(mass, symbols):
                raise ModelError(f"{what}, the derivative of the residual by the accelerations, depends on {text}")
        moved = casadi.SX.sym("moved", self.n_second)
        shifted = casadi.substitute(mass, self.y[: self.n_second], self.y[: self.n_second] + moved)
        masses = self._at_start(casadi.densify(shifted), moved)
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

    def _nominals(self) -> tuple[float, ...]:
        """Usual sizes of the states: coordinates, rates, states of first order."""

        def size(given: variable) -> float:
            return given.nominal or abs(given.value) or 1.0

        q, rates = self.given["q"], self.given["rates"]
        return (
            *(size(each) for each in q.values()),
            *(
                size(rates[each]) if each in rates and (rates[each].nominal or rates[each].value) else size(q[each])
                for each in q
            ),
            *(size(each) for each in self.given["x"].values()),
        )

    def _variables(self, letter: str, causality: Causality) -> tuple[Variable, ...]:
        kind = causality.capitalize()
        return tuple(
            Variable(
                name, g.unit, g.description or f"{kind} {name}", causality, g.value, g.minimum, g.maximum, g.nominal
            )
            for name, g in self.given[letter].items()
        )

    def _parameters(self) -> tuple[Variable, ...]:
        """The user's parameters, and the start of every state."""
        q, x = self.given["q"], self.given["x"]
        starts = [(f"start.{each}", g.unit, f"Start of {each}", g.value) for each, g in q.items()]
        rates = self._start_by_name("rates")
        starts += [
            (f"start_rate.{each}", rate_unit(q[each].unit), f"Rate of {each} at the start", rate)
            for each, rate in zip(q, rates, strict=True)
        ]
        starts += [(f"start.{each}", g.unit, f"Start of {each}", g.value) for each, g in x.items()]
        return (
            *self._variables("p", "parameter"),
            *(Variable(name, unit, text, "parameter", start=value) for name, unit, text, value in starts),
        )

    def _feedthrough(
        self, shown: Sequence[tuple[Variable, casadi.SX]], residual: casadi.SX, motion: MotionSymbols
    ) -> dict[str, tuple[str, ...]]:
        """Output → inputs that it depends on, directly or through accelerations."""
        names = list(self.given["u"])
        mass, load = casadi.jacobian_sparsity(residual, motion.a), casadi.jacobian_sparsity(residual, motion.u)
        by_row: list[set[int]] = [set() for _ in range(residual.numel())]
        for row, column in zip(*load.get_triplet(), strict=True):
            by_row[row].add(column)
        # coupled accelerations depend on the inputs of all equations of second order
        if not mass.is_diag():
            coupled = set().union(*by_row[: self.n_second])
            by_row[: self.n_second] = [coupled] * self.n_second
        found = {}
        for each, value in shown:
            inputs = set(casadi.jacobian_sparsity(value, motion.u).get_triplet()[1])
            for k in casadi.jacobian_sparsity(value, motion.a).get_triplet()[1]:
                inputs |= by_row[k]
            found[each.name] = tuple(names[k] for k in sorted(inputs))
        return found


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
        if not isfinite(value):
            raise ModelError(f"{name} of the point must be finite, got {value}")
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
