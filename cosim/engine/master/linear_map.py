"""Maps of signals on their way from an output to an input: conversions of units, linear transformations, and tables."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import overload

from flexfmu.cosim.engine.errors import InputError


@dataclass(frozen=True)
class LinearMap:
    """y = factor x + offset; time derivatives are multiplied by the factor alone."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, value: float) -> float:
        """The mapped value; unchanged to the last bit by the identity."""
        return value if self == IDENTITY else self.factor * value + self.offset

    @overload
    def then(self, other: LinearMap) -> LinearMap: ...
    @overload
    def then(self, other: TableMap) -> TableMap: ...
    def then(self, other: SignalMap) -> SignalMap:
        """This map, then the other."""
        if isinstance(other, TableMap):
            return TableMap(other.pairs, self.then(other.before))
        if self == IDENTITY or other == IDENTITY:
            return other if self == IDENTITY else self
        return LinearMap(other.factor * self.factor, other.factor * self.offset + other.offset)


IDENTITY = LinearMap()
"""Leaves everything as it is."""


@dataclass(frozen=True)
class TableMap:
    """Whole numbers, Booleans (0 and 1) or items of enumerations, each mapped to a number; nothing in between.

    Attributes:
        pairs: whole numbers and what they are mapped to.
        before: what is done to a signal before it is looked up, rounded.
    """

    pairs: tuple[tuple[int, float], ...]
    before: LinearMap = IDENTITY

    def __call__(self, value: float) -> float:
        """What the table has for the value.

        Raises:
            InputError: it has nothing.
        """
        key = self.before(value)
        for source, target in self.pairs:
            # as a number is rounded on its way into an Integer
            if abs(source - key) <= 0.5:
                return target
        known = ", ".join(str(source) for source, _ in self.pairs)
        raise InputError(f"the table of a connection has nothing for {key:g}, only for {known}; complete it")

    def then(self, other: SignalMap) -> TableMap:
        """This map, then the other; values that the other doesn't know are left out."""
        return TableMap(tuple(_mapped(self.pairs, other)), self.before)


SignalMap = LinearMap | TableMap


def _mapped(pairs: Iterable[tuple[int, float]], other: SignalMap) -> Iterable[tuple[int, float]]:
    """The pairs with their targets mapped."""
    for source, target in pairs:
        try:
            yield source, other(target)
        except InputError:
            continue
