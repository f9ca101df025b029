"""The cases of a sweep: grids, samples and tables of values of scene keys, from ``--vary`` options, CSV files and Python.

A case is calculated from its number, so that 100,000 of them take no memory.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.keys import parse_value, split_values


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
class CaseTable:
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


MOST_CASES = 10_000_000
"""More cases than this are taken for a mistake."""

_INTEGER = re.compile(r"[+-]?\d+")
_RANGE = re.compile(r"(?P<low>[^:]+):(?P<high>[^:]+?)(?::(?P<count>[^:]+))?")


def parse_vary(option: str) -> tuple[str, Values]:
    """The key and its values from ``KEY=FROM:TO:N``, ``KEY=FROM:TO`` (an interval for samples) or ``KEY=VALUE,VALUE``.

    Values are TOML: numbers, true, false, arrays, tables, texts; texts may do without quotes.

    Raises:
        InputError: the option has another form.
    """
    key, sign, text = option.partition("=")
    key, text = key.strip(), text.strip()
    if not (sign and key and text):
        raise InputError(
            f"--vary {option!r} isn't KEY=VALUES: write payload.mass=0:8:50 or trajectory.duration=0.3,0.4"
        )
    return key, parse_values(text, key)


def parse_values(text: str, key: str) -> Values:
    """The values of a key from a text; form and errors as for `parse_vary`."""
    span = _RANGE.fullmatch(text)
    ends = [_number(span[each]) for each in ("low", "high")] if span else []
    if span is None or None in ends:
        return [_value(each, key) for each in _parts(text, key)]
    low, high = (each for each in ends if each is not None)
    if not (math.isfinite(low) and math.isfinite(high)):
        raise InputError(f"`{key}` can't go from {low} to {high}: give finite numbers")
    if span["count"] is None:
        return Span(low, high)
    # equally spaced values with both ends
    if not _INTEGER.fullmatch(span["count"].strip()) or not 2 <= int(span["count"]) <= MOST_CASES:
        raise InputError(f"`{key}` needs a whole number of values from 2 on, got {span['count']!r} in {text!r}")
    return _spaced(low, high, int(span["count"]))


def _spaced(low: float, high: float, count: int) -> list[float]:
    """Equally spaced values; whole numbers if the ends and all between them are."""
    if isinstance(low, int) and isinstance(high, int) and (high - low) % (count - 1) == 0:
        return [low + i * ((high - low) // (count - 1)) for i in range(count)]
    return [float(each) for each in np.linspace(low, high, count)]


def _number(text: str) -> float | None:
    """A number, ``int`` where it is written as one; None for any other text."""
    try:
        return int(text) if _INTEGER.fullmatch(text.strip()) else float(text)
    except ValueError:
        return None


def _parts(text: str, key: str) -> list[str]:
    """The parts between commas; errors as for `_value`."""
    try:
        return split_values(text, key)
    except SceneError as error:
        raise InputError(str(error)) from error


def _value(text: str, key: str) -> Any:
    """A value as `flexfmu.model.scene.keys.parse_value` reads it.

    Raises:
        InputError: it is no value.
    """
    try:
        return parse_value(text, key)
    except SceneError as error:
        raise InputError(str(error)) from error


def make_cases(varied: Mapping[str, Values], sample: str | None = None, seed: int = 0) -> tuple[Cases, list[str]]:
    """The grid of lists of values, or a sample of lists and intervals; and notes on values that are left out.

    Args:
        varied: key → values.
        sample: ``lhs:N`` or ``sobol:N``; None for the grid.
        seed: of the sample.

    Raises:
        InputError: nothing is varied, an interval has no sample, or the sample is of another form.
    """
    if not varied:
        raise InputError("a sweep needs something to vary: --vary payload.mass=0:8:50, or --cases FILE.csv")
    notes: list[str] = []
    values = {key: _distinct(key, each, notes) for key, each in varied.items()}
    if sample is not None:
        method, count = _parse_sample(sample)
        return Sample(tuple(values), tuple(values.values()), method, count, seed), notes
    for key, each in values.items():
        if isinstance(each, Span):
            raise InputError(
                f"`{key}` = {each.low:g}:{each.high:g} is an interval: say how many values, {each.low:g}:{each.high:g}:10, or "
                f"sample it with --sample lhs:100"
            )
    grid = Grid(tuple(values), tuple(tuple(each) for each in values.values() if not isinstance(each, Span)))
    if len(grid) > MOST_CASES:
        raise InputError(
            f"these are {len(grid)} cases, more than {MOST_CASES}: give fewer values, or --sample lhs:1000"
        )
    return grid, notes


def _distinct(key: str, values: Values, notes: list[str]) -> Values:
    """The values without repetitions.

    Raises:
        InputError: there is none.
    """
    if isinstance(values, Span):
        return values
    found = list({repr(each): each for each in values}.values())
    if not found:
        raise InputError(f"`{key}` has no values: give at least one")
    if len(found) < len(values):
        notes.append(
            f"`{key}`: {len(values) - len(found)} of {len(values)} values repeat others, each is simulated once"
        )
    return found


def _parse_sample(text: str) -> tuple[str, int]:
    """Method and number of cases of a sample.

    Raises:
        InputError: the text isn't ``lhs:N`` or ``sobol:N``, or N doesn't suit the method.
    """
    method, _, count = text.partition(":")
    if method not in ("lhs", "sobol") or not _INTEGER.fullmatch(count) or not 1 <= int(count) <= MOST_CASES:
        raise InputError(f"a sample is lhs:N or sobol:N with a number of cases from 1 on, got {text!r}")
    number = int(count)
    if method == "sobol" and number & (number - 1):
        near = 1 << round(math.log2(number))
        raise InputError(f"Sobol points are balanced for powers of two alone, got {number}: give sobol:{near}")
    return method, number


def read_cases(path: str | Path) -> tuple[CaseTable, list[str]]:
    """Cases from a CSV file: keys in the first line, perhaps with units in brackets; an empty cell leaves the scene's value.

    Raises:
        InputError: the file can't be read or isn't such a table.
    """
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            lines = [line for line in csv.reader(file, skipinitialspace=True, strict=True) if any(line)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"can't read the cases in {path}: {reason}") from error
    if len(lines) < 2:
        raise InputError(f"{path} has no cases: write keys of the scene in the first line, and a line for each case")
    keys = tuple(re.sub(r" \[[^\]]*[^\]\d][^\]]*\]$", "", cell).strip() for cell in lines[0])
    # values
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        if len(line) != len(keys):
            raise InputError(f"line {number} of {path} has {len(line)} cells, its first line {len(keys)}")
        rows.append([_value(cell, key) if cell.strip() else None for key, cell in zip(keys, line, strict=True)])
    return make_table(keys, rows, str(path))


def make_table(
    keys: Sequence[str], rows: Iterable[Sequence[Any]], source: str = "cases"
) -> tuple[CaseTable, list[str]]:
    """Cases from rows of values; and a note on rows that are left out.

    Raises:
        InputError: there are no rows, or a key is empty or there twice.
    """
    for key in keys:
        if not key or list(keys).count(key) > 1:
            raise InputError(f"{source}: the key {key!r} is {'there twice' if key else 'empty'}")
    known: dict[str, tuple[Any, ...]] = {}
    total = 0
    for row in rows:
        total += 1
        known.setdefault(repr(list(row)), tuple(row))
    if not known or not keys:
        raise InputError(f"{source}: there are no cases, or no keys")
    notes = (
        [f"{source}: {total - len(known)} of {total} cases repeat others, each is simulated once"]
        if len(known) < total
        else []
    )
    return CaseTable(tuple(keys), tuple(known.values())), notes


def as_cases(cases: Any, sample: str | None = None, seed: int = 0) -> Cases:
    """Cases from Python: a mapping from keys to values, a sequence of changes, or the path of a CSV file.

    Raises:
        InputError: they are of another form, or a path or a sequence is to be sampled.
    """
    if isinstance(cases, Mapping):
        varied = {key: _as_values(key, each, sampled=sample is not None) for key, each in cases.items()}
        return make_cases(varied, sample, seed)[0]
    if sample is not None:
        raise InputError("a sample needs the keys with their values, {'payload.mass': (0.0, 8.0)}")
    if isinstance(cases, str | Path):
        return read_cases(cases)[0]
    rows = [*cases] if isinstance(cases, Sequence) else []
    if not rows or not all(isinstance(each, Mapping) for each in rows):
        raise InputError(
            f"cases are a dict from keys to values, a list of dicts, or the path of a CSV file, got {cases!r:.60}"
        )
    keys = list(dict.fromkeys(key for row in rows for key in row))
    return make_table(keys, [[_plain(row.get(key)) for key in keys] for row in rows])[0]


def _as_values(key: str, values: Any, *, sampled: bool) -> Values:
    """The values of a key from a list, an array, a text as ``--vary`` has it, or a single value.

    In a sample a pair of numbers is an interval.
    """
    if isinstance(values, str):
        return parse_values(values, key)
    if isinstance(values, Span):
        return values
    if sampled and isinstance(values, tuple) and len(values) == 2:
        return Span(*(_plain(each) for each in values))
    return [_plain(each) for each in values] if isinstance(values, Iterable) else [_plain(values)]


def _plain(value: Any) -> Any:
    """A value of NumPy as one of Python."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value
