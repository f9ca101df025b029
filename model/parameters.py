"""The two layers of parameters: what a user sets (p), and what follows from it once (d), so that no evaluation repeats it."""

from __future__ import annotations

from collections.abc import Mapping

import casadi

from flexfmu.model.symbolic import Variable


class ParameterRegistry:
    """Collects the parameters that the chosen effects ask for while a model is put together.

    Derived values are symbols in the equations of motion; their expressions go into the function ``derive(p) -> d``.
    """

    def __init__(self) -> None:
        self._variables: dict[str, Variable] = {}
        self._symbols: dict[str, casadi.SX] = {}
        self._derived: dict[str, tuple[casadi.SX, casadi.SX]] = {}

    def parameter(self, variable: Variable) -> casadi.SX:
        """The symbol of an FMI parameter; the same variable asked for twice is one parameter."""
        known = self._variables.setdefault(variable.name, variable)
        if known != variable:
            raise ValueError(f"parameter `{variable.name}` is declared twice with different attributes")
        return self._symbols.setdefault(variable.name, casadi.SX.sym(variable.name))

    def derived(self, name: str, expression: casadi.SX) -> casadi.SX:
        """The symbol of a value that is computed once from the parameters and named for memoisation.

        A value that is constant (no parameter in it) stays a number.
        """
        if casadi.SX(expression).is_constant():
            return casadi.SX(expression)
        if name not in self._derived:
            self._derived[name] = (casadi.SX.sym(name), expression)
        return self._derived[name][0]

    def switch(self, name: str) -> casadi.SX:
        """The symbol of a value that is zero among the derived ones, and that the runtime sets while the model moves."""
        return self._derived.setdefault(name, (casadi.SX.sym(name), casadi.SX(0)))[0]

    def position(self, derived: casadi.SX) -> int:
        """Index in d of the symbol of a derived value."""
        return next(i for i, (symbol, _) in enumerate(self._derived.values()) if casadi.is_equal(symbol, derived))

    def find_derived(self, name: str) -> casadi.SX:
        """The symbol of a derived value, zero where no effect has asked for it."""
        return self._derived[name][0] if name in self._derived else casadi.SX(0)

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The FMI parameters in the order of p."""
        return tuple(self._variables.values())

    @property
    def p(self) -> casadi.SX:
        """Symbols of all parameters, shape (n_parameters, 1)."""
        return casadi.vertcat(*(self._symbols[name] for name in self._variables))

    @property
    def d(self) -> casadi.SX:
        """Symbols of all derived values, shape (n_derived, 1)."""
        return casadi.vertcat(*(symbol for symbol, _ in self._derived.values()))

    @property
    def starts(self) -> Mapping[str, float]:
        """Start value of each parameter by name."""
        return {name: float(v.start) for name, v in self._variables.items() if v.start is not None}

    def resolved(self) -> casadi.SX:
        """The derived values as expressions of the parameters alone, shape (n_derived, 1)."""
        expressions: list[casadi.SX] = []
        symbols: list[casadi.SX] = []
        for symbol, expression in self._derived.values():
            known = casadi.vertcat(*symbols), casadi.vertcat(*expressions)
            expressions.append(casadi.substitute(expression, *known) if symbols else expression)
            symbols.append(symbol)
        return casadi.vertcat(*expressions)
