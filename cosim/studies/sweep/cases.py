"""The cases of a sweep: grids, samples and tables of values of scene keys. A case is calculated from its number, so that
100,000 of them take no memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from typing import Any, Protocol

import numpy as np


@dataclass(frozen=True)
class Span:
    """An interval of values for samples; whole numbers where both ends are ``int``."""

    low: float
    high: float

    @property
    def is_whole(self) -> bool:
        """Whether its values are whole numbers."""
        return isinstance(self.low, int) and isinstance(self.high, int)

    def at(self, share: float) -> float:
        """The value at a share of the interval, 0 to 1."""
        if self.is_whole:
            return min(int(self.low + share * (self.high - self.low + 1)), self.high)
        return float(self.low + share * (self.high - self.low))


Values = Sequence[Any] | Span
"""What a key may be: a list of values, or an interval that is sampled."""


class Cases(Protocol):
    """The cases of a sweep.

    Attributes:
        keys: keys of the scene that are varied.
    """

    @property
    def keys(self) -> tuple[str, ...]: ...

    def __len__(self) -> int: ...

    def __getitem__(self, number: int) -> tuple[Any, ...]:
        """The values of the keys in the case of this number, from 0."""
        ...


@dataclass(frozen=True)
class Grid:
    """All combinations of values, the last key varying fastest."""

    keys: tuple[str, ...]
    levels: tuple[tuple[Any, ...], ...]

    def __len__(self) -> int:
        return math.prod(len(each) for each in self.levels)

    def __getitem__(self, number: int) -> tuple[Any, ...]:
        if not 0 <= number < len(self):
            raise IndexError(number)
        values = []
        for level in reversed(self.levels):
            number, place = divmod(number, len(level))
            values.append(level[place])
        return tuple(reversed(values))


@dataclass(frozen=True)
class Sample:
    """Values that are spread over intervals and lists by a design of experiments.

    Attributes:
        keys: the varied keys.
        values: the interval or the list of each.
        method: ``lhs`` (Latin hypercube) or ``sobol`` (scrambled Sobol sequence), both by `scipy.stats.qmc`.
        count: number of cases; for Sobol a power of two.
        seed: of the random numbers.
    """

    keys: tuple[str, ...]
    values: tuple[Values, ...]
    method: str
    count: int
    seed: int = 0

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, number: int) -> tuple[Any, ...]:
        if not 0 <= number < self.count:
            raise IndexError(number)
        shares = self._points[number].tolist()
        return tuple(
            each.at(share) if isinstance(each, Span) else each[min(int(share * len(each)), len(each) - 1)]
            for each, share in zip(self.values, shares, strict=True)
        )

    @cached_property
    def _points(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Points (N, d) of the unit cube."""
        from scipy.stats import qmc

        if self.method == "sobol":
            return np.asarray(qmc.Sobol(len(self.keys), seed=self.seed).random_base2(self.count.bit_length() - 1))
        return np.asarray(qmc.LatinHypercube(len(self.keys), seed=self.seed).random(self.count))


@dataclass(frozen=True)
class Table:
    """Cases one by one; None leaves a key as it is in the scene."""

    keys: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, number: int) -> tuple[Any, ...]:
        return self.rows[number]


def changes_of(cases: Cases, number: int) -> dict[str, Any]:
    """What a case changes in the scene: key → value."""
    return {key: value for key, value in zip(cases.keys, cases[number], strict=True) if value is not None}


def digest(cases: Cases) -> str:
    """A hash of all cases."""
    found = sha256(repr(cases.keys).encode())
    for number in range(len(cases)):
        found.update(repr(cases[number]).encode())
    return found.hexdigest()[:16]
