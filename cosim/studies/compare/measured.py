"""Measured signals from a log: a CSV file with a header, whose columns are given the names and units of simulated signals."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Union

import numpy as np

from flexfmu.cosim.engine.errors import InputError, ResultsError, suggestion
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.showing import UNITS

if TYPE_CHECKING:
    import pandas

Log = Union[str, Path, Recording, "pandas.DataFrame"]
"""A file, or signals in memory; the time of a data frame is its column `time` or its index."""


@dataclass(frozen=True)
class Mapped:
    """What a column of a log is.

    Attributes:
        signal: name of the simulated signal, or ``time``.
        factor, offset: the signal is factor * column + offset, in SI units; factor None for that of the unit in the header.
    """

    signal: str
    factor: float | None = None
    offset: float = 0.0


def parse_mapping(text: str) -> tuple[str, Mapped]:
    """Return column and meaning of ``column=signal*factor+offset``; the factor is a number or a unit, ``deg`` for example.

    Raises:
        InputError: the text has another form.
    """
    column, equals, meaning = text.rpartition("=")
    if not equals or not column.strip():
        raise InputError(f"--map takes MEASURED=SIGNAL, tau1=joint1.torque*1e-3 for example, got {text!r}")
    return column.strip(), as_mapped(meaning)


def as_mapped(text: str) -> Mapped:
    """Return the meaning of a column from ``signal*factor+offset``, of which factor and offset may be left out.

    Raises:
        InputError: factor or offset is neither a number nor a unit.
    """
    found = re.fullmatch(r"\s*([^*+]+?)\s*(?:\*\s*([^+\s]+(?:[eE]\+\d+)?))?\s*(?:\+\s*(\S+))?\s*", text)
    if found is None:
        raise InputError(
            f"a measured column is mapped to SIGNAL*FACTOR+OFFSET, joint1.torque*1e-3 for example, got {text!r}"
        )
    signal, factor, offset = found.groups()
    return Mapped(signal, None if factor is None else _number(factor, text), _number(offset or "0", text))


def _number(word: str, text: str) -> float:
    try:
        value = UNITS[word][1] if word in UNITS else float(word)
    except ValueError:
        raise InputError(
            f"{word!r} in {text!r} is neither a number nor a known unit; units: {', '.join(UNITS)}"
        ) from None
    if not math.isfinite(value):
        raise InputError(f"{word!r} in {text!r} must be finite")
    return value


def read_log(log: Log, mapping: Mapping[str, Mapped], signals: Mapping[str, str]) -> Recording:
    """Read the columns of a log that are signals of a simulation.

    The separator is a comma, semicolon or tab; with semicolons or tabs numbers may have a decimal comma. Lines before the header
    that begin with ``#`` are skipped. A name may have a unit in brackets, ``torque [mN.m]``, which is converted to the SI unit.
    Empty cells are missing values. Column `time` or `t` is the time, whatever its case, unless one is mapped to ``time``.

    Args:
        log: the CSV file; a ``.parquet`` or ``.mat`` file, or what is in memory, in SI units where the mapping has no factor.
        mapping: name of a column → its meaning; others are taken where their name is that of a signal.
        signals: name of a simulated signal → its unit.

    Raises:
        ResultsError: the file can't be read.
        InputError: it has no time, no signal, a column or signal doesn't exist, the time decreases, or a unit is unknown.
    """
    source = Path(log) if isinstance(log, str | Path) else "the measurement"
    table, units = _table(Path(log)) if isinstance(log, str | Path) else (_in_memory(log), {})
    meaning = _meaning(source, table, mapping, signals)
    # the time first, which every signal needs
    (time_name,) = (name for name, each in meaning.items() if each.signal == "time")
    time = _converted(table, units, time_name, meaning[time_name])
    known = np.isfinite(time)
    time = time[known]
    if time.size == 0 or np.any(np.diff(time) < 0.0):
        row = int(np.argmax(np.diff(time) < 0.0)) + 2 if time.size else 1
        raise InputError(f"{source}: the time in column {time_name!r} must not decrease, but it does in row {row}")
    columns = {
        each.signal: Column(signals[each.signal], _converted(table, units, name, each)[known])
        for name, each in meaning.items()
        if each.signal != "time"
    }
    return Recording(time, columns)


def _in_memory(log: Recording | pandas.DataFrame) -> dict[str, np.ndarray]:
    """Return the columns of signals in memory by name, the time among them."""
    if isinstance(log, Recording):
        return {"time": log.time, **{name: each.values for name, each in log.columns.items()}}
    columns = {str(name): log[name].to_numpy() for name in log.columns}
    usual = any(name.lower() in ("time", "t") for name in columns)
    return columns if usual else {"time": np.asarray(log.index, dtype=np.float64), **columns}


def _table(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Return the columns of a file by name without their units, and these units."""
    if path.suffix in (".parquet", ".mat"):
        return _in_memory(Recording.read(path)), {}
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ResultsError(f"can't read {path}: {getattr(error, 'strerror', None) or error}") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) < 2:
        raise ResultsError(f"{path} has no rows: it must have a header and at least one row of numbers")
    separator = max(",;\t", key=lines[0].count)
    header, *rows = csv.reader(lines, delimiter=separator)
    # a second line of units
    own = [cell.strip().strip("[]") for cell in rows[0]] if not any(map(_is_number, rows[0])) else []
    rows = rows[1:] if own else rows
    names, units = list[str](), dict[str, str]()
    for i, cell in enumerate(header):
        found = re.fullmatch(r"(.*?)\s*[\[(]([^\])]*)[\])]\s*", cell.strip())
        # brackets with a number belong to the name: link11.bending[1]
        name, unit = (
            found.groups()
            if found and not found[2].strip().isdigit()
            else (cell.strip(), own[i] if i < len(own) else "")
        )
        name = name.replace(";", ",")  # as `Recording.write_csv` has it
        names.append(name)
        units[name] = unit.strip()
    values = [_numbers(path, names, number, row, separator) for number, row in enumerate(rows, start=1)]
    return dict(zip(names, np.array(values, dtype=np.float64).T, strict=True)), units


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _numbers(path: Path, names: Sequence[str], number: int, row: Sequence[str], separator: str) -> list[float]:
    """Return a row's numbers; NaN for empty cells and texts.

    Raises:
        ResultsError: the row has another number of cells than the header.
    """
    if len(row) != len(names):
        raise ResultsError(f"{path}, row {number}: {len(row)} cells for the {len(names)} columns of the header")
    cells = row if separator == "," else [cell.replace(",", ".") for cell in row]
    return [float(cell) if _is_number(cell) else math.nan for cell in cells]


def _meaning(
    path: Path | str, table: Mapping[str, object], mapping: Mapping[str, Mapped], signals: Mapping[str, str]
) -> dict[str, Mapped]:
    """Return what the columns are that are used: mapped ones, and those named like a signal that no other is mapped to.

    Raises:
        InputError: a column or signal doesn't exist, or there is no time or no signal.
    """
    found = dict[str, Mapped]()
    for column, each in mapping.items():
        if column not in table:
            raise InputError(f"{path} has no column {column!r}; {suggestion(column, table)}")
        if each.signal != "time" and each.signal not in signals:
            raise InputError(
                f"column {column!r} can't be {each.signal!r}: there is no such signal; {suggestion(each.signal, signals)}"
            )
        found[column] = each
    taken = [each.signal for each in found.values()]
    twice = next((name for name in taken if taken.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"two columns of {path} are mapped to {twice!r}")
    # the time by its usual names, then equal names
    if "time" not in taken:
        usual = next((name for name in table if name.lower() in ("time", "t")), None)
        if usual is None:
            raise InputError(f'{path} has no column `time`; map one, --map "{next(iter(table))}=time" for example')
        found[usual] = Mapped("time")
    found |= {name: Mapped(name) for name in table if name in signals and name not in found and name not in taken}
    if len(found) < 2:
        example = f'--map "{next((name for name in table if name not in found), "column")}=joint1.torque"'
        raise InputError(
            f"no column of {path} is a signal; map one, {example} for example; columns: {', '.join(table)}"
        )
    return found


def _converted(table: Mapping[str, np.ndarray], units: Mapping[str, str], name: str, each: Mapped) -> np.ndarray:
    """Return a column in SI units.

    Raises:
        InputError: the unit in the header is unknown, and no factor is given.
    """
    factor, unit = each.factor, units.get(name, "")
    if factor is None:
        if unit and unit not in UNITS:
            raise InputError(
                f'column {name!r} has the unknown unit {unit!r}; give the factor to the SI unit, --map "{name}={each.signal}*1e-3" '
                "for example"
            )
        factor = UNITS[unit][1] if unit else 1.0
    return np.asarray(factor * table[name] + each.offset, dtype=np.float64)
