"""Maps from an output to an input: conversions of units, linear transformations, and tables."""

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
        """The mapped value; the identity returns it bit for bit."""
        return value if self == IDENTITY else self.factor * value + self.offset

    @overload
    def then(self, other: LinearMap) -> LinearMap: ...
    @overload
    def then(self, other: TableMap) -> TableMap: ...
    def then(self, other: SignalMap) -> SignalMap:
        """The composition: this map first, then the other."""
        if isinstance(other, TableMap):
            return TableMap(other.pairs, self.then(other.before))
        if self == IDENTITY or other == IDENTITY:
            return other if self == IDENTITY else self
        return LinearMap(other.factor * self.factor, other.factor * self.offset + other.offset)


IDENTITY = LinearMap()
"""The identity."""


@dataclass(frozen=True)
class TableMap:
    """Maps integers, Booleans (0 and 1) or enumeration items to numbers, without interpolation.

    Attributes:
        pairs: integers and the numbers that they are mapped to.
        before: linear map that is applied first; its result is rounded and looked up.
    """

    pairs: tuple[tuple[int, float], ...]
    before: LinearMap = IDENTITY

    def __call__(self, value: float) -> float:
        """The table's number for the value.

        Raises:
            InputError: the table has no entry for it.
        """
        key = self.before(value)
        for source, target in self.pairs:
            # rounded as a Real that feeds an Integer
            if abs(source - key) <= 0.5:
                return target
        known = ", ".join(str(source) for source, _ in self.pairs)
        raise InputError(f"the table of a connection has nothing for {key:g}, only for {known}; complete it")

    def then(self, other: SignalMap) -> TableMap:
        """The composition: this map first, then the other; values that the other has no entry for are left out."""
        return TableMap(tuple(_mapped(self.pairs, other)), self.before)


SignalMap = LinearMap | TableMap


def _mapped(pairs: Iterable[tuple[int, float]], other: SignalMap) -> Iterable[tuple[int, float]]:
    """The pairs with their numbers mapped by ``other``, without those that it has no entry for."""
    for source, target in pairs:
        try:
            yield source, other(target)
        except InputError:
            continue
