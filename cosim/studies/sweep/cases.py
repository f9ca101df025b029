"""The cases of a sweep: grids, samples and tables of values of scene keys, from ``--vary`` options, CSV files and Python."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flexfmu.cosim.design.identification.result import Identification
from flexfmu.cosim.engine.errors import InputError
from flexfmu.errors import read_text
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.keys import parse_value, split_values, value_at
from flexfmu.model.scene.schema import Scene

MOST_CASES = 1_000_000
"""More cases than this are taken for a mistake."""

NAMED = 20
"""Values of a key that ``sweep.json`` lists; of more it has the ends."""

_INTEGER = re.compile(r"[+-]?\d+")
_RANGE = re.compile(r"(?P<low>[^:]+):(?P<high>[^:]+?)(?::(?P<count>[^:]+))?")


class Span(NamedTuple):
    """An interval of values for samples."""

    low: float
    high: float


Values = Sequence[Any] | Span
"""What a key may be: a list of values, or an interval that is sampled."""


@dataclass(frozen=True)
class Cases:
    """The cases of a sweep.

    Attributes:
        keys: keys of the scene that are varied.
        rows: values of the keys in each case; None leaves a key as it is in the scene.
        about: how a grid or a sample was made.
    """

    keys: tuple[str, ...]
    rows: Sequence[tuple[Any, ...]]
    about: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.rows)

    def changes(self, number: int) -> dict[str, Any]:
        """What the case of this number, from 0, changes in the scene: key → value."""
        return {key: value for key, value in zip(self.keys, self.rows[number], strict=True) if value is not None}

    def described(self) -> dict[str, Any]:
        """The cases for ``sweep.json``, with a hash of all of them."""
        found = sha256(repr(self.keys).encode())
        for row in self.rows:
            found.update(repr(row).encode())
        return {"count": len(self), "keys": list(self.keys), **self.about, "hash": found.hexdigest()[:16]}


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
    low, high = (_number(span[each]) for each in ("low", "high")) if span else (None, None)
    if span is None or low is None or high is None:
        try:
            return [parse_value(each, key) for each in split_values(text, key)]
        except SceneError as error:
            raise InputError(str(error)) from error
    if not (math.isfinite(low) and math.isfinite(high)):
        raise InputError(f"`{key}` can't go from {low} to {high}: give finite numbers")
    if span["count"] is None:
        return Span(low, high)
    # equally spaced values with both ends; whole numbers if these and all between them are
    if not _INTEGER.fullmatch(span["count"].strip()) or not 2 <= (count := int(span["count"])) <= MOST_CASES:
        raise InputError(f"`{key}` needs a whole number of values from 2 on, got {span['count']!r} in {text!r}")
    if isinstance(low, int) and isinstance(high, int) and (high - low) % (count - 1) == 0:
        return [low + i * ((high - low) // (count - 1)) for i in range(count)]
    return [float(each) for each in np.linspace(low, high, count)]


def _number(text: str) -> float | None:
    """A number, ``int`` where it is written as one; None for any other text."""
    try:
        return int(text) if _INTEGER.fullmatch(text.strip()) else float(text)
    except ValueError:
        return None


def make_cases(
    varied: Mapping[str, Values], sample: str | None = None, seed: int = 0, scene: Scene | None = None
) -> tuple[Cases, list[str]]:
    """All combinations of lists of values, the last key varying fastest, or a sample; and notes on values that are left out.

    Args:
        varied: key → values.
        sample: ``lhs:N`` (Latin hypercube) or ``sobol:N`` (scrambled Sobol sequence), both by `scipy.stats.qmc`, which spread N
            cases over intervals and lists; None for all combinations.
        seed: of the sample.
        scene: intervals between whole numbers have these alone for keys that are whole in this scene, and all numbers for others;
            None for whole ones.

    Raises:
        InputError: nothing is varied, an interval has no sample, or the sample is of another form.
        SceneError: the scene has no such key.
    """
    if not varied:
        raise InputError("a sweep needs something to vary: --vary payload.mass=0:8:50, or --cases FILE.csv")
    notes: list[str] = []
    values: dict[str, Values] = {}
    for key, each in varied.items():
        distinct = each if isinstance(each, Span) else list({repr(value): value for value in each}.values())
        if not distinct:
            raise InputError(f"`{key}` has no values: give at least one")
        if len(distinct) < len(each):
            notes.append(
                f"`{key}`: {len(each) - len(distinct)} of {len(each)} values repeat others, each is simulated once"
            )
        if sample is None and isinstance(each, Span):
            raise InputError(
                f"`{key}` = {each.low:g}:{each.high:g} is an interval: say how many values, {each.low:g}:{each.high:g}:10, or "
                f"sample it with --sample lhs:100"
            )
        values[key] = distinct
    keys = tuple(values)
    about: dict[str, Any] = {"values": {key: _listed(each) for key, each in values.items()}}
    if sample is not None:
        method, points = _points(sample, len(keys), seed)
        data = None if scene is None else scene.model_dump()
        draws = [_draw(each, key, data) for key, each in values.items()]
        rows = [tuple(draw(share) for draw, share in zip(draws, shares, strict=True)) for shares in points.tolist()]
        return Cases(keys, rows, {"sample": method, "seed": seed, **about}), notes
    if (count := math.prod(len(each) for each in values.values())) > MOST_CASES:
        raise InputError(f"these are {count} cases, more than {MOST_CASES}: give fewer values, or --sample lhs:1000")
    return Cases(keys, [*product(*values.values())], about), notes


def _listed(values: Values) -> Any:
    """A list of values, or the ends of a long one or of an interval."""
    if isinstance(values, Span):
        return f"{values.low!r}:{values.high!r}"
    return list(values) if len(values) <= NAMED else f"{len(values)} values from {values[0]!r} to {values[-1]!r}"


def _draw(values: Values, key: str, data: Mapping[str, Any] | None) -> Callable[[float], Any]:
    """A function from a share, 0 to 1, to a value of a list or an interval; ``data`` is that of the scene."""
    if not isinstance(values, Span):
        return lambda share: values[min(int(share * len(values)), len(values) - 1)]
    low, high = values
    is_whole = isinstance(low, int) and isinstance(high, int)
    if is_whole and (data is None or type(value_at(data, key, "the scene")) is int):
        return lambda share: min(int(low + share * (high - low + 1)), high)
    return lambda share: float(low + share * (float(high) - float(low)))


def _points(sample: str, dimension: int, seed: int) -> tuple[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """Method of a sample, and its points (N, dimension) of the unit cube.

    Raises:
        InputError: the text isn't ``lhs:N`` or ``sobol:N``, or N doesn't suit the method.
    """
    method, _, text = sample.partition(":")
    if method not in ("lhs", "sobol") or not _INTEGER.fullmatch(text) or not 1 <= (count := int(text)) <= MOST_CASES:
        raise InputError(f"a sample is lhs:N or sobol:N with a number of cases from 1 on, got {sample!r}")
    from scipy.stats import qmc

    if method == "lhs":
        return method, qmc.LatinHypercube(dimension, seed=seed).random(count)
    if count & (count - 1):
        near = 1 << round(math.log2(count))
        raise InputError(f"Sobol points are balanced for powers of two alone, got {count}: give sobol:{near}")
    return method, qmc.Sobol(dimension, seed=seed).random_base2(count.bit_length() - 1)


def read_cases(path: str | Path) -> tuple[Cases, list[str]]:
    """Cases from a CSV file: keys in the first line, perhaps with units in brackets; an empty cell leaves the scene's value. Or draws from an
    ``identified.json``.

    Raises:
        InputError: the file can't be read or isn't such a table.
    """
    if Path(path).suffix == ".json":
        draws = Identification.read(path).draws()
        return make_table([*draws[0]] if draws else [], [[*each.values()] for each in draws], str(path))
    try:
        text = io.StringIO(read_text(path), newline="")
        lines = [line for line in csv.reader(text, skipinitialspace=True, strict=True) if any(line)]
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
        try:
            rows.append(
                [parse_value(cell, key) if cell.strip() else None for key, cell in zip(keys, line, strict=True)]
            )
        except SceneError as error:
            raise InputError(str(error)) from error
    return make_table(keys, rows, str(path))


def make_table(keys: Sequence[str], rows: Sequence[Sequence[Any]], source: str = "cases") -> tuple[Cases, list[str]]:
    """Cases from rows of values; and a note on rows that are left out.

    Raises:
        InputError: there are no rows, or a key is empty or there twice.
    """
    for key in keys:
        if not key or list(keys).count(key) > 1:
            raise InputError(f"{source}: the key {key!r} is {'there twice' if key else 'empty'}")
    known = list({repr(row): tuple(row) for row in map(list, rows)}.values())
    if not known or not keys:
        raise InputError(f"{source}: there are no cases, or no keys")
    left = len(rows) - len(known)
    notes = [f"{source}: {left} of {len(rows)} cases repeat others, each is simulated once"] if left else []
    return Cases(tuple(keys), known), notes


def as_cases(cases: Any, sample: str | None = None, seed: int = 0, scene: Scene | None = None) -> Cases:
    """Cases from Python: a mapping from keys to values, a sequence of changes, or the path of a CSV file.

    In a sample a pair of numbers is an interval; ``scene`` as for `make_cases`.

    Raises:
        InputError: they are of another form, or a path or a sequence is to be sampled.
    """

    def values(key: str, given: Any) -> Values:
        # a list, an array, a text as ``--vary`` has it, or a single value
        if isinstance(given, str):
            return parse_values(given, key)
        if sample is not None and isinstance(given, tuple) and len(given) == 2:
            return Span(*map(_plain, given))
        return [_plain(each) for each in given] if isinstance(given, Iterable) else [_plain(given)]

    if isinstance(cases, Mapping):
        return make_cases({key: values(key, each) for key, each in cases.items()}, sample, seed, scene)[0]
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


def _plain(value: Any) -> Any:
    """A value of NumPy as one of Python."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value


def short_text(value: Any) -> str:
    """A value of a scene key as people read it: four digits; of a table its kind or name."""
    if isinstance(value, Mapping) and ("kind" in value or "name" in value):
        return str(value.get("kind", value.get("name")))
    return f"{float(f'{value:.4g}'):g}" if isinstance(value, float) else "" if value is None else str(value)


def text_of(value: Any) -> str:
    """A value of a scene key as a cell: numbers so that they read back exactly, texts as they are, the rest as JSON."""
    if value is None or isinstance(value, str):
        return value or ""
    return json.dumps(value, ensure_ascii=False)
