"""What a user writes of a model: variables, events, and names with their checks."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from math import isfinite
from typing import Any, TypedDict

import casadi

from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.units import unit_exponents

Equation = Any
"""A function of named symbols, or expressions: one, a list in order, or a dict by name."""


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
    """

    value: Any
    unit: str = "1"
    _: KW_ONLY
    nominal: float | None = None
    minimum: float | None = None
    maximum: float | None = None
    description: str = ""

    @property
    def size(self) -> float:
        """Usual size in ``unit``, once its numbers are checked."""
        return self.nominal or abs(self.value) or 1.0


@dataclass(frozen=True)
class event:  # noqa: N801 - written by users as a call
    """An event: the passage of a number through zero, at which the equations see another side, or states are reset.

        bounce = flexfmu.event(lambda q: q.height, -1, lambda v, p: {"der(height)": -p.restitution * v.height})

    Args:
        number: function of q, v, x, u, p and t, of the size of 1; of time alone for an instant. Equations have its sign, 1 or -1, as
            ``s.NAME``.
        direction: of the passages that reset states: 1 upwards, -1 downwards, 0 both.
        reset: states behind the event by name, a function that gives a dict; others stay.
        at_start: whether it happens at the start where its number is zero or above there.

    Raises:
        ModelError: the direction is none of these.
    """

    number: Equation
    direction: int = 0
    reset: Equation = None
    _: KW_ONLY
    at_start: bool = False

    def __post_init__(self) -> None:
        if self.direction not in (-1, 0, 1):
            raise ModelError(
                f"the direction of an event is 1 (upwards), -1 (downwards) or 0 (both), got {self.direction!r}"
            )


@dataclass(frozen=True)
class part:  # noqa: N801 - written by users as a call
    """A discrete-time part in the FMU of a model: a controller that samples, for example.

        parts={"pd": flexfmu.part(pd, lambda q, v: [q.angle, v.angle])}

    At its sample instants offset + k sample_time it takes its inputs and sets its outputs, which are held in between. Equations, outputs
    and other parts have these as states, ``x["pd.torque"]``; before the first instant they are zero. Parts that sample at the same
    instant see each other's earlier outputs. A run that starts later starts with a sample.

    Args:
        block: a `flexfmu.model.symbolic.SymbolicBlock`, or a function with `flexfmu.controller` that CasADi can trace.
        inputs: the block's inputs, a function of q, v, x, u, p and t, in their order or by name.
    """

    block: Any
    inputs: Equation = ()


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


class Common(TypedDict, total=False):
    """What every model may have."""

    u: Mapping[str, Any] | None
    """Input → start value, a number or `variable`."""
    p: Mapping[str, Any] | None
    """Parameter → start value."""
    derived: Mapping[str, Equation] | None
    """Derived parameter → function of p, computed once; it belongs to p."""
    outputs: Mapping[str, Equation] | None
    """Further output → function of the model's variables, or `variable` with one."""
    events: Mapping[str, event] | None
    """Event → `event`; equations and outputs may take ``s``, the sides."""
    parts: Mapping[str, part] | None
    """Part → `part`; its parameters are the model's, ``PART.PARAMETER``."""
    description: str
    """One sentence."""


class Mechanics(Common, total=False):
    """What a model with coordinates may have beside them."""

    rates: Mapping[str, Any] | None
    """Coordinate → its rate at the start; zero for others."""
    x: Mapping[str, Any] | None
    """State of first order beside the coordinates, as of an actuator → start value."""
    friction: Mapping[str, Equation] | None
    """Coordinate → breakaway force of its dry friction, a number or function of p, or a pair of it and the force while it slips, a function
    of q, v and p. It sticks where it can, and events switch to slip and back."""


_PART = r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?"


RESERVED = ("start", "start_rate", "state", "statistics")
"""Beginnings of names of the FMU's own variables."""


def check_name(name: Any) -> None:
    """Check that the name of a variable is a structured one of FMI.

    Raises:
        ModelError: it isn't, or the FMU has such a variable of its own.
    """
    if not isinstance(name, str) or name == "time" or not re.fullmatch(rf"{_PART}(\.{_PART})*", name, re.ASCII):
        raise ModelError(f"{name!r} can't be the name of a variable; write it like angle, arm.angle or temperature[1]")
    head = name.partition(".")[0]
    if head == "integrator" or (head in RESERVED and head != name):
        raise ModelError(
            f"{name!r} can't be the name of a variable: integrator and {', '.join(RESERVED)}.* are the FMU's own"
        )


def with_unit(scope: str, name: str, value: Any) -> variable:
    """A user's entry, a variable or its value, with its unit checked.

    Raises:
        ModelError: the unit is unknown.
    """
    given = value if isinstance(value, variable) else variable(value)
    try:
        unit_exponents(given.unit)
    except (ModelError, TypeError) as error:
        reason = (
            error if isinstance(error, ModelError) else f"must be a text such as N.m, 1 for none, got {given.unit!r}"
        )
        raise ModelError(f"unit of {scope} '{name}': {reason}") from None
    return given


def declared(scope: str, name: str, value: Any) -> variable:
    """A user's entry with its unit and numbers checked.

    Raises:
        ModelError: a number isn't finite, the nominal value isn't positive, the start is out of range, or the name is none.
    """
    given = with_unit(scope, name, value)
    check_name(name)
    unit = "" if given.unit == "1" else f" {given.unit}"

    def number(what: str, entry: Any) -> float:
        try:
            found = float("a truth value" if isinstance(entry, bool) else entry)
        except (TypeError, ValueError, RuntimeError):
            raise ModelError(f"{what} of {scope} '{name}' must be a number, got {entry!r}") from None
        if not isfinite(found) or (what == "nominal" and found <= 0.0):
            kind = "positive" if what == "nominal" else "finite"
            raise ModelError(f"{what} of {scope} '{name}' must be a {kind} number, got {found}{unit}")
        return found

    nominal, low, high = (
        None if (entry := getattr(given, what)) is None else number(what, entry)
        for what in ("nominal", "minimum", "maximum")
    )
    start = number("start", given.value)
    if low is not None and high is not None and low > high:
        raise ModelError(f"the minimum of {scope} '{name}', {low}{unit}, is above its maximum, {high}{unit}")
    for bound, side, excess in ((low, "at least", -1.0), (high, "at most", 1.0)):
        if bound is not None and excess * (start - bound) > 0.0:
            raise ModelError(f"start of {scope} '{name}' must be {side} {bound}{unit}, got {start}{unit}")
    return replace(given, value=start, nominal=nominal, minimum=low, maximum=high)


def rate_unit(unit: str) -> str:
    """Unit of a time derivative: ``m`` → ``m/s``, ``m/s`` → ``m/s2``."""
    head, slash, power = unit.rpartition("/s")
    if slash and (power == "" or power.isdigit()):
        return f"{head}/s{int(power or 1) + 1}"
    return f"{unit[:-1]}.s)" if unit.endswith(")") else f"{unit}/s"


def column(entries: Sequence[Any]) -> casadi.SX:
    """A column of scalars, of none too; CasADi's slices of a single number are rows."""
    return casadi.vertcat(casadi.SX(0, 1), *entries)
