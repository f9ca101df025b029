"""The symbols of a model, and a user's equations as expressions of them, checked."""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import isfinite
from typing import Any

import casadi
import numpy as np

from flexfmu.fmu_build.block_build import check_block
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.own_entries import (
    Equation,
    Mechanics,
    Names,
    check_name,
    column,
    declared,
    event,
    part,
    variable,
    with_unit,
)
from flexfmu.model.symbolic import SymbolicBlock

SINGULAR = 1e-12
"""Ratio of the singular values of a matrix that counts as singular."""

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


def _block(what: str, source: Any) -> SymbolicBlock:
    """The block of a part.

    Raises:
        ModelError: there is none, or it can't be in the FMU of a model.
    """
    block = getattr(source.block, "symbolic_block", source.block) if isinstance(source, part) else None
    if not isinstance(block, SymbolicBlock):
        raise ModelError(
            f"{what} must be flexfmu.part of a SymbolicBlock or of a function with flexfmu.controller, got {source!r:.60}"
        )
    check_block(block)
    if block.instants or block.c_files:
        raise ModelError(f"{what} has C files or instants of its own; make it a slave beside the model")
    return block


class Draft:
    """The symbols of a model, and its equations as expressions of them.

    Attributes:
        y, v, a: symbols of all unknowns: coordinates of second order, of first order, time.
        time: symbol of the time.
        unsolved, solution: symbols of the variables of constraints, and what takes their place in equations.
        iterated: what takes the symbols' place in the solution, a constant for its derivatives.
        scopes: argument of a user's function → what it gets.
    """

    def __init__(
        self, name: str, q: Mapping[str, Any] | None = None, z: Mapping[str, Any] | None = None, **given: Any
    ) -> None:
        if not isinstance(name, str) or not name:
            raise ModelError(f"the name of a model is a text, got {name!r}")
        self.name = name
        try:
            self._declare({"q": q, "rates": None, "x": None, "z": z, "u": None, "p": None, **given})
            self._check_names()
        except ModelError as error:
            raise ModelError(f"model '{name}': {error}") from None
        self._make_symbols()
        self._derive()

    def _declare(self, entries: dict[str, Any]) -> None:
        """What the user gives, and the states and parameters of parts."""
        arguments = Mechanics.__annotations__  # those of Common too
        if unknown := entries.keys() - {"q", "z"} - arguments.keys():
            raise ModelError(
                f"there is no argument '{min(unknown)}'; beside the equations there are {', '.join(arguments)}"
            )
        self.description: str = entries.pop("description", "")
        for scope, each in entries.items():
            if not isinstance(each, Mapping | None):
                raise ModelError(f"{scope} is a dict by name, got {each!r}")
        self.derivations, outputs, self.events, friction, parts = (
            dict(entries.pop(scope, None) or {}) for scope in ("derived", "outputs", "events", "friction", "parts")
        )
        # what parts hold are states behind the user's own, whose rate is zero and which samples reset
        self.states, held, tuned = list(entries["x"] or {}), dict[str, variable](), dict[str, variable]()
        for each, source in parts.items():
            block = _block(f"part '{each}'", source)
            held |= {f"{each}.{one.name}": variable(0.0, one.unit) for one in block.outputs}
            held |= {f"{each}.state[{k}]": variable(start) for k, start in enumerate(block.states, 1)}
            held[f"{each}.samples"] = variable(0.0)
            tuned |= {
                f"{each}.{one.name}": variable(one.start, one.unit, minimum=one.minimum, maximum=one.maximum)
                for one in block.parameters
            }
            self.events[f"{each}.sample"] = self._sample(each, source, block)
        entries |= {"x": {**(entries["x"] or {}), **held}, "p": {**(entries["p"] or {}), **tuned}}
        self.n_held = len(held)
        self.given = {
            scope: {each: declared(scope, each, value) for each, value in (found or {}).items()}
            for scope, found in entries.items()
        }
        self.outputs = {each: with_unit("output", each, source) for each, source in outputs.items()}
        self.friction = {each: f if isinstance(f, tuple) else (f, f) for each, f in friction.items()}

    def _check_names(self) -> None:
        """Check that there are states, that names are unique, and that what refers to others finds them."""
        q, rates, x, z, u, p = self.given.values()
        if not q and not x:
            raise ModelError("there are no states; give at least one")
        own = [*q, *x, *z, *u, *p]
        names = Counter([*own, *self.derivations, *self.events]) | Counter([*own, *self.outputs])
        for each in names:
            check_name(each)
        if twice := [each for each, count in names.items() if count > 1]:
            raise ModelError(f"the name '{twice[0]}' is there more than once; names must be unique")
        if unknown := rates.keys() - q.keys():
            raise ModelError(f"rates name '{min(unknown)}', which is no coordinate; these are {', '.join(q)}")
        self.given["rates"] = {each: rates.get(each, variable(0.0)) for each in q}
        if wrong := [each for each, entry in self.events.items() if not isinstance(entry, event)]:
            raise ModelError(f"event '{wrong[0]}' must be made by flexfmu.event")
        if wrong := [each for each, pair in self.friction.items() if each not in q or len(pair) != 2]:
            raise ModelError(f"friction is coordinate → force, or a pair of forces, got '{wrong[0]}'")

    def _make_symbols(self) -> None:
        """Symbols of unknowns, of which time is the last, inputs and constants, and what users' functions get."""
        q, _, x, z, u, p = self.given.values()
        self.n_second, self.n_first = len(q), len(x)
        n = self.n_second + self.n_first + 1
        self.y, self.v, self.a = (casadi.SX.sym(letter, n) for letter in "yva")
        # constants, breakaway forces and directions of friction, sides of events
        constants = len(p) + len(self.derivations)
        self.u = casadi.SX.sym("u", len(u))
        self.d = casadi.SX.sym("d", constants + 2 * len(self.friction) + len(self.events))
        self.time = self.y[n - 1]
        self.unsolved = self.solution = self.iterated = casadi.SX.sym("z", len(z))

        def named(letter: str, names: Sequence[str], symbols: casadi.SX) -> Names:
            return Names(f"{letter} of model '{self.name}'", dict(zip(names, casadi.vertsplit(symbols), strict=True)))

        second = slice(0, self.n_second)
        self.scopes: dict[str, Any] = {
            "q": named("q", list(q), self.y[second]),
            "v": named("v", list(q), self.v[second]),
            "a": named("a", list(q), self.a[second]),
            "x": named("x", list(x), self.v[self.n_second : n - 1]),
            "z": named("z", list(z), self.unsolved),
            "u": named("u", list(u), self.u),
            "p": named("p", [*p, *self.derivations], column(casadi.vertsplit(self.d)[:constants])),
            "s": named("s", list(self.events), column(casadi.vertsplit(self.d)[constants + 2 * len(self.friction) :])),
            "t": self.time,
        }

    def _derive(self) -> None:
        """Derived parameters as expressions of the others, which come first; what parts hold starts where it does."""
        q, _, x, _, _, p = self.given.values()
        self.p = casadi.SX.sym("p", len(p) + len(q) * 2 + len(x) - self.n_held)
        self.derived = column(casadi.vertsplit(self.p)[: len(p)])
        breakaway = {f"friction.{each}": pair[0] for each, pair in self.friction.items()}
        for each, source in (self.derivations | breakaway).items():
            (value,) = self.evaluated(f"derived parameter '{each}'", source, [each], scopes="p", switches=True)
            value = casadi.substitute(value, column(casadi.vertsplit(self.d)[: self.derived.numel()]), self.derived)
            if casadi.depends_on(value, self.d):
                raise ModelError(
                    f"derived parameter '{each}' of model '{self.name}' needs one that comes later; change their order"
                )
            self.derived = casadi.vertcat(self.derived, value)
        self.derived = column([*casadi.vertsplit(self.derived), *[0.0] * (len(self.friction) + len(self.events))])

    def _sample(self, name: str, source: part, block: SymbolicBlock) -> event:
        """The event at which a part samples: its outputs, next states and number of samples follow."""
        inputs, outputs = ([each.name for each in some] for some in (block.inputs, block.outputs))

        def own(scope: str, names: Sequence[str]) -> casadi.SX:
            return column([self.scopes[scope][f"{name}.{each}"] for each in names])

        def reset() -> dict[str, casadi.SX]:
            u = column(
                self.evaluated(f"inputs of part '{name}'", source.inputs, inputs, scopes="qvxupts", switches=True)
            )
            states = [f"state[{k}]" for k in range(1, len(block.states) + 1)]
            arguments = own("x", states), u, own("p", [each.name for each in block.parameters])
            after = casadi.floor((self.time - block.offset) / block.sample_time + 1e-6) + 1
            values = casadi.vertsplit(casadi.vertcat(block.output(*arguments), block.update(*arguments), after))
            return {f"{name}.{each}": value for each, value in zip([*outputs, *states, "samples"], values, strict=True)}

        def number(x: Names, t: casadi.SX) -> casadi.SX:
            return t - block.offset - block.sample_time * x[f"{name}.samples"]

        return event(number, 1, reset, at_start=True)

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
        where = f"{what} of model '{self.name}'"
        found = self.called(where, source, scopes) if callable(source) else source
        if isinstance(found, Mapping):
            if unknown := [each for each in found if each not in names]:
                raise ModelError(f"{where} gives {unknown[0]!r}, which isn't among {', '.join(names)}")
            lacking = [each for each in names if each not in found]
            if lacking and missing is None:
                raise ModelError(f"{where} gives nothing for '{lacking[0]}'")
            found = [found.get(each, missing) for each in names]
        elif isinstance(found, casadi.SX | casadi.DM):
            found = casadi.vertsplit(casadi.SX(found))
        elif isinstance(found, Iterator):
            found = list(found)
        elif isinstance(found, str) or not isinstance(found, Sequence | np.ndarray):
            found = [found]
        if len(found) != len(names):
            raise ModelError(f"{where} gives {len(found)} expressions, but must give {len(names)}: {', '.join(names)}")
        return [
            self._checked(f"{where}, {each}", value, scopes, switches) for each, value in zip(names, found, strict=True)
        ]

    def called(self, where: str, source: Callable[..., Any], scopes: str) -> Any:
        """What a user's function gives."""
        # parameters with a default, of a loop for example, keep it
        parameters = inspect.signature(source).parameters.items()
        wanted = [each for each, one in parameters if each in scopes or one.default is one.empty]
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
        symbols = casadi.vertcat(self.y, self.v, self.a, self.u, self.d, self.unsolved)
        own = {each.element_hash() for each in casadi.symvar(symbols)}
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
        if casadi.depends_on(expression, self.unsolved):
            expression = casadi.substitute(expression, self.unsolved, self.solution)
        return casadi.densify(expression)

    def at_start(self, expression: casadi.SX, unknowns: casadi.SX) -> casadi.Function:
        """An expression at the start, as a function of some of its symbols."""
        q, rates, x, u = (self.start_by_name(letter) for letter in ("q", "rates", "x", "u"))
        parameters = [value for letter in ("p", "q", "rates", "x") for value in self.start_by_name(letter)]
        parameters = parameters[: self.p.numel()]
        derived = casadi.Function("d", [self.p], [self.derived])(parameters)
        y, v = [*q, *[0.0] * self.n_first, 0.0], [*rates, *x, 1.0]
        symbols = casadi.vertcat(self.y, self.v, self.u, self.d)
        at = casadi.substitute(expression, symbols, casadi.vertcat(*y, *v, *u, derived))
        return casadi.Function("start", [unknowns], [at])

    def start_by_name(self, letter: str) -> list[float]:
        """Start values in the order of the symbols."""
        return [each.value for each in self.given[letter].values()]
