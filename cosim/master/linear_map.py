"""Linear maps between signals: conversions of units and transformations on the way from an output to an input."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LinearMap:
    """y = factor x + offset; time derivatives are multiplied by the factor alone."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, value: float) -> float:
        """The mapped value; unchanged to the last bit by the identity."""
        return value if self == IDENTITY else self.factor * value + self.offset

    def then(self, other: LinearMap) -> LinearMap:
        """This map, then the other."""
        if self == IDENTITY or other == IDENTITY:
            return other if self == IDENTITY else self
        return LinearMap(other.factor * self.factor, other.factor * self.offset + other.offset)


IDENTITY = LinearMap()
"""Leaves everything as it is."""
