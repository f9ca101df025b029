"""Files of signals: CSV in fmpy's format, Parquet, MAT for MATLAB and Octave, and MCAP for Foxglove and PlotJuggler.

MAT, by SciPy in version 5 of the format: every signal is a column vector beside ``time``. Its name is made a valid one:
``link11.bending[1]`` is ``link11_bending_1``. The structs ``names`` and ``units`` have the recorded name and the unit of each variable,
and ``about`` says what is in the file.

MCAP: messages in JSON with a JSON Schema, log times from simulation time. There is a channel for each part, such as ``/joint1`` and
``/link11``, with a message at every instant. ``link11.bending[1]`` is the field ``bending_1`` of ``/link11``; the schema has the recorded
name of a field as its title and the unit as its description.

Parquet, by pyarrow: the unit of a column is ``unit`` in the metadata of its field.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
import re
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import numpy as np
from pydantic_core import to_json

from flexfmu.cosim.engine.columns import TWICE, Column, coded, csv_cells
from flexfmu.cosim.engine.errors import InputError, ResultsError, SignalFileError, extra
from flexfmu.cosim.engine.files import replacing, write_pieces
from flexfmu.cosim.engine.showing import cell_text, safe_cell
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.errors import LARGEST_TABLE, read_bytes, read_text
from flexfmu.fmu_build.archive import ANY_RATIO, LARGEST_RATIO

About = Mapping[str, str]
"""Key → text for the metadata of a file."""

NOTHING: About = {}

LINES = 96
"""Number of lines of a CSV file that are written at once: few enough for memory that is used again instead of new pages."""


def write_csv(path: Path, time: RealArray, columns: Mapping[str, Column], about: About = NOTHING) -> Path:
    """Write time and values; see `flexfmu.cosim.engine.results.Recording.write_csv`."""
    for name in columns:
        if any(character in name for character in ';"\n'):
            raise ResultsError(f"the signal name {name!r} has a semicolon, quote or line break; rename it")
    names = [safe_cell(name.replace(",", ";")) for name in ("time", *columns)]
    head = ",".join(f'"{name}"' for name in names) + "\n"
    return write_pieces(path, itertools.chain([head], _lines([Column("s", time), *columns.values()])))


def _lines(columns: list[Column]) -> Iterator[str]:
    """Yield the lines of the table, some hundred at once."""
    are_numbers = all(each.texts is None and each.values.dtype == np.float64 for each in columns)
    for begin in range(0, columns[0].values.size, LINES):
        piece = slice(begin, begin + LINES)
        # numbers alone in whole lines, texts cell by cell
        if are_numbers:
            yield csv_cells(np.stack([each.values[piece] for each in columns], axis=1)) + "\n"
            continue
        table = [Column(each.unit, each.values[piece], texts=each.texts).shown() for each in columns]
        yield "".join(",".join(row) + "\n" for row in zip(*table, strict=True))


def read_csv(path: Path) -> tuple[RealArray, dict[str, Column]]:
    """Return times (N,) [s] and signals; see `flexfmu.cosim.engine.results.Recording.read_csv`."""
    try:
        head, _, body = read_text(path).partition("\n")
        names = [cell_text(name.strip().strip('"')).replace(";", ",") for name in head.split(",")]
        if not body.strip():
            raise ValueError("it has no rows")
        # numpy reads tables of numbers alone many times faster
        table, texts, known = (
            _with_texts(body) if '"' in body else (np.loadtxt(body.splitlines(), delimiter=",", ndmin=2), set(), [])
        )
    except OSError as error:
        raise SignalFileError(f"can't read {path}: {error.strerror}") from error
    except (ValueError, IndexError, csv.Error) as error:
        raise SignalFileError(f"{path} is no table of signals: {error}") from error
    if names[0] != "time" or table.shape[1] != len(names):
        raise SignalFileError(f"{path} is no table of signals: its first column must be named time")
    columns = {name: Column("", table[:, i], texts=known if i in texts else None) for i, name in enumerate(names) if i}
    return _ascending(table[:, 0], path, 2), columns


def _ascending(time: RealArray, path: Path, first: int) -> RealArray:
    """Return times (N,) [s] as they are; ``first`` is the number of the first one's line or row.

    Raises:
        SignalFileError: one isn't finite, or lies before the one above it; the message names its line.
    """
    wrong = ~np.isfinite(time) | (np.diff(time, prepend=time[:1]) < 0.0)
    if wrong.any():
        i = int(np.argmax(wrong))
        before = f"comes after {time[i - 1]:.9g} s" if i and np.isfinite(time[i]) else "is no time"
        raise SignalFileError(
            f"{path}, line {i + first}: {time[i]:.9g} s {before}; times must be finite and not decrease"
        )
    return time


def _with_texts(body: str) -> tuple[RealArray, set[int], list[str]]:
    """Return the table (N, n) with texts replaced by their indices, the columns of texts, and the list of texts."""
    rows = [row for row in csv.reader(io.StringIO(body, newline=""), quoting=csv.QUOTE_NONNUMERIC) if row]
    # the first row tells columns of texts from columns of numbers
    texts = {i for i, cell in enumerate(rows[0]) if isinstance(cell, str)}
    codes: dict[str, int] = {}
    table = [
        [codes.setdefault(cell_text(cell), len(codes)) if i in texts else float(cell) for i, cell in enumerate(row)]
        for row in rows
    ]
    return np.array(table, dtype=np.float64), texts, [*codes]


LONGEST = 63
"""Largest number of characters of a name in MATLAB (`namelengthmax`)."""

TAKEN = frozenset([
    "time", "names", "units", "about", "break", "case", "catch", "classdef", "continue", "else", "elseif", "end",
    "for", "function", "global", "if", "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try",
    "while",
])  # fmt: skip
"""Names of what else is in the file, and MATLAB's keywords (`iskeyword`)."""

HEADER = b"MATLAB 5.0 MAT-file, results of flexfmu".ljust(116)
"""Text at the start of the file; SciPy's has the date, so that equal results wouldn't give equal files."""

ONCE = "For functions that need each instant once, interp1 for example: k = [diff(time) > 0; true]; time(k), joint1_torque(k)."


def write_mat(path: Path, time: RealArray, columns: Mapping[str, Column], about: Mapping[str, str]) -> Path:
    """Write signals as variables, and return the path.

    Args:
        path: of the file.
        time: (N,) instants [s].
        columns: name → signal; signals of type String become cell arrays.
        about: key → text for the variable ``about``, which says what instants that appear twice mean, too.

    Raises:
        ResultsError: the file can't be written, with the system's reason.
    """
    from scipy.io import savemat

    names = valid_names(columns)
    variables: dict[str, object] = {"time": time}
    for name, column in columns.items():
        variables[names[name]] = column.values if column.texts is None else np.array(column.listed(), dtype=object)
    variables["names"] = {"time": "time", **{names[name]: name for name in columns}}
    variables["units"] = {"time": "s", **{names[name]: column.unit for name, column in columns.items()}}
    variables["about"] = "\n".join([*(f"{key}: {text}" for key, text in about.items()), TWICE, ONCE])
    # in memory first, for the header
    content = BytesIO()
    savemat(cast(Any, content), variables, long_field_names=True, oned_as="column")
    content.getbuffer()[: len(HEADER)] = HEADER
    with replacing(path) as temporary:
        temporary.write_bytes(content.getbuffer())
    return path


def valid_names(names: Iterable[str]) -> dict[str, str]:
    """Return name of a signal → different, valid name in MATLAB: at most 63 letters, digits and underscores, a letter first."""
    found, taken = dict[str, str](), set(TAKEN)
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
        plain = (plain if plain[:1].isalpha() else f"x_{plain}")[:LONGEST]
        # names that differ in other characters only, or in the case alone, are numbered
        valid, number = plain, 1
        while valid in taken:
            number += 1
            ending = f"_v{number}"
            valid = plain[: LONGEST - len(ending)] + ending
        taken.add(valid)
        found[name] = valid
    return found


_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Type of an element → NumPy's, without the byte order (MATLAB, MAT-File Format, "Data Types")."""

_CHARACTERS = {1: "latin-1", 2: "latin-1", 4: "utf-16-{}", 16: "utf-8", 17: "utf-16-{}", 18: "utf-32-{}"}
"""Type of an element of text → encoding, with the file's byte order."""

_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _CHAR, _NUMERIC, _OPAQUE, _COMPLEX = 1, 2, 4, range(6, 16), 17, 0x800
"""Classes of matrices, and the flag of complex ones."""


def read_mat(path: Path) -> tuple[RealArray, dict[str, Column]]:
    """Return times (N,) [s] and signals of a file by `write_mat`.

    A file of other programs needs a vector ``time``; vectors of its length are signals without units. Read here and not by SciPy,
    which believes what a damaged file says of itself, and crashes.

    Raises:
        SignalFileError: the file can't be read, or has no vector ``time``.
    """
    try:
        found = dict(_mat_variables(memoryview(read_bytes(path))))
    except OSError as error:
        raise SignalFileError(f"can't read {path}: {error.strerror}") from error
    except (ValueError, TypeError, LookupError, struct.error, zlib.error, RecursionError) as error:
        raise SignalFileError(
            f"can't read {path}: it is damaged, or no MAT file of version 5 ({error}); save it in MATLAB with -v7"
        ) from error
    time = np.ravel(found.get("time", ()))
    if not time.size or time.dtype.kind not in "iuf":
        problem = "its `time` is no vector of real numbers" if "time" in found else "it has no variable `time`"
        raise SignalFileError(f"{path} is no file of signals: {problem}")
    time = time.astype(np.float64)
    _ascending(time, path, 1)
    names, units = (each if isinstance(each := found.get(key), dict) else {} for key in ("names", "units"))
    columns = {}
    for variable, values in found.items():
        if variable in ("time", "names", "units", "about") or values is None or np.size(values) != time.size:
            continue
        name, unit, values = _text(names.get(variable)) or variable, _text(units.get(variable)), np.ravel(values)
        texts = values.dtype.kind in "OU"
        columns[name] = coded(unit, map(_text, values)) if texts else Column(unit, values.astype(np.float64))
    return time, columns


def _mat_variables(data: memoryview) -> Iterator[tuple[str, Any]]:
    """Yield name and value of the variables of a MAT file; see `_mat_value`."""
    order = {b"IM": "<", b"MI": ">"}.get(bytes(data[126:128]), "")
    if not order:
        raise ValueError("its header has no byte order")
    room = min(LARGEST_TABLE, max(ANY_RATIO, LARGEST_RATIO * len(data)))
    for kind, content in _mat_elements(data[128:], order):
        if kind == _COMPRESSED:
            unpacking = zlib.decompressobj()
            unpacked = unpacking.decompress(content, room)
            if not unpacking.eof:
                raise ValueError("a variable doesn't end, or unpacks to too much")
            room -= len(unpacked) - 1  # one byte more: zero would be no limit
            kind, content = next(_mat_elements(memoryview(unpacked), order))
        if kind == _MATRIX:
            yield _mat_value(content, order)


def _mat_elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Yield type and content of the elements that stand one behind the other."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        at += 8
        following = at + (size if kind == _COMPRESSED else -(-size // 8) * 8)
        if kind >> 16:  # up to four bytes that stand within the head
            kind, size, at, following = kind & 0xFFFF, kind >> 16, at - 4, at
        if at + size > len(data):
            raise ValueError("an element is longer than what holds it")
        yield kind, data[at : at + size]
        at = following


def _mat_value(matrix: memoryview, order: str) -> tuple[str, Any]:
    """Return name and value of a variable, cell or field: numbers (N,), a text, texts (N,), a dictionary; None for what is no signal."""
    (_, flags), *parts = _mat_elements(matrix, order) if len(matrix) else [(0, memoryview(bytes(4)))]
    flag = struct.unpack_from(f"{order}I", flags)[0]
    kind = flag & 0xFF
    if kind not in (_CELL, _STRUCT, _CHAR, *_NUMERIC):  # an object, a sparse matrix, nothing
        return b"".join(bytes(each[1]) for each in parts[kind != _OPAQUE :][:1]).decode(), None
    (_, shape), (_, name), *rest = parts
    sizes = np.frombuffer(shape, f"{order}i4")
    value: Any = None
    if kind in _NUMERIC and not flag & _COMPLEX:
        numbers = np.frombuffer(rest[0][1], order + _NUMBERS[rest[0][0]])
        value = numbers if sizes.max() == numbers.size else None
    elif kind == _CHAR:
        text = bytes(rest[0][1]).decode(_CHARACTERS[rest[0][0]].format("le" if order == "<" else "be"), "replace")
        rows = min(int(sizes[0]), len(text))  # a table of characters, column by column
        value = np.array([text[i::rows] for i in range(rows)]) if rows > 1 else text
    elif kind == _CELL:
        value = np.array([_mat_value(content, order)[1] for _, content in rest], dtype=object)
    elif kind == _STRUCT:
        (length,), names = struct.unpack_from(f"{order}i", rest[0][1]), bytes(rest[1][1])
        fields = [names[i : i + length].partition(b"\0")[0].decode() for i in range(0, len(names), length)]
        value = dict(zip(fields, (_mat_value(content, order)[1] for _, content in rest[2:]), strict=False))
    return bytes(name).decode(), value


def _text(value: object) -> str:
    """Return a text of a MAT file; any other value is none."""
    return value if isinstance(value, str) else ""


PIECE = 4096
"""Number of instants whose values are turned into Python's numbers at once."""


def write_mcap(path: Path, time: RealArray, columns: Mapping[str, Column], about: Mapping[str, str]) -> Path:
    """Write signals as messages, and return the path.

    Args:
        path: of the file.
        time: (N,) instants [s], zero or positive; log times are these in whole nanoseconds.
        columns: name → signal. NaN and infinite values become null, which JSON has for them.
        about: key → text for the metadata ``flexfmu`` of the file; the metadata ``units`` have the units.

    Raises:
        ResultsError: the file can't be written, with the system's reason.
    """
    from mcap.writer import Writer

    channels: dict[str, dict[str, Column]] = {}
    for name, column in columns.items():
        channels.setdefault(_part(name), {})[name] = column
    stamps = np.rint(1e9 * time).astype(np.int64).tolist()
    with replacing(path) as temporary, temporary.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="flexfmu")
        # one schema and channel for each part
        identifiers, tables = [], []
        for part, signals in channels.items():
            fields = valid_names(_field(name, part) for name in signals)
            names = [fields[_field(name, part)] for name in signals]
            properties = {
                field: {
                    "type": "string" if each.texts is not None else ["number", "null"],
                    "title": name,
                    "description": each.unit,
                }
                for field, (name, each) in zip(names, signals.items(), strict=True)
            }
            content = json.dumps({"type": "object", "properties": properties}).encode()
            schema = writer.register_schema(f"flexfmu.{part}", "jsonschema", content)
            identifiers.append(writer.register_channel(f"/{part}", "json", schema))
            tables.append((names, [column.listed() for column in signals.values()]))
        # all parts at each instant, in the order of time; some thousand instants at once, which takes little memory
        for begin in range(0, time.size, PIECE):
            piece, pieces = slice(begin, begin + PIECE), []
            for _, listed in tables:
                cut = (each[piece] if isinstance(each, list) else each[piece].tolist() for each in listed)
                pieces.append([*zip(*cut, strict=True)])
            for i, stamp in enumerate(stamps[begin : begin + PIECE]):
                for identifier, (names, _), rows in zip(identifiers, tables, pieces, strict=True):
                    data = to_json(dict(zip(names, rows[i], strict=True)), inf_nan_mode="null")
                    writer.add_message(identifier, stamp, data, stamp, sequence=begin + i)
        writer.add_metadata("flexfmu", {**about, "jumps": TWICE})
        writer.add_metadata("units", {name: column.unit for name, column in columns.items()})
        writer.finish()
    return path


def _part(name: str) -> str:
    """Return the part that a signal belongs to: ``link11`` for ``der(link11.bending[1],2)``."""
    return name.removeprefix("der(").partition(".")[0]


def _field(name: str, part: str) -> str:
    """Return a signal's name within its part."""
    return name.replace(f"{part}.", "", 1)


def write_parquet(path: Path, time: RealArray, columns: Mapping[str, Column], about: Mapping[str, str]) -> Path:
    """Write signals as columns after ``time``, and return the path.

    Args:
        path: of the file.
        time: (N,) instants [s].
        columns: name → signal; signals of type String become columns of texts.
        about: key → text for the metadata of the file, which says what instants that appear twice mean, too.

    Raises:
        ResultsError: the file can't be written, with the system's reason.
    """
    import pyarrow

    every, kinds = {"time": Column("s", time), **columns}, (pyarrow.float64(), pyarrow.string())
    arrays = {
        name: (pyarrow.array(each.listed(), kinds[each.texts is not None]), each.unit) for name, each in every.items()
    }
    # a dictionary pays for texts alone
    texts = [name for name, column in columns.items() if column.texts is not None]
    return write_arrays(path, arrays, {**about, "jumps": TWICE}, texts or False)


def write_arrays(
    path: Path, columns: Mapping[str, tuple[Any, str]], about: Mapping[str, str], dictionary: bool | list[str] = True
) -> Path:
    """Write a Parquet table, whose columns have their units as metadata, and return the path.

    Args:
        path: of the file.
        columns: name → array of pyarrow, and unit; empty for none.
        about: key → text for the metadata of the file.
        dictionary: columns whose different values are written once; all or none of them.

    Raises:
        ResultsError: the file can't be written, with the system's reason.
    """
    import pyarrow
    from pyarrow import parquet

    units = {name: {"unit": unit} if unit else None for name, (_, unit) in columns.items()}
    fields = [pyarrow.field(name, array.type, metadata=units[name]) for name, (array, _) in columns.items()]
    table = pyarrow.table([array for array, _ in columns.values()], pyarrow.schema(fields, dict(about)))
    with replacing(path) as temporary:
        parquet.write_table(table, temporary, use_dictionary=dictionary)
    return path


def read_parquet(path: Path) -> tuple[RealArray, dict[str, Column]]:
    """Return times (N,) [s] and signals of a Parquet file; a file of other programs may lack the units.

    Raises:
        SignalFileError: the file can't be read, has no column ``time``, or a column is of neither numbers nor texts.
    """
    import pyarrow
    from pyarrow import parquet

    try:
        table = parquet.read_table(path)
        names = table.column_names
        if "time" not in names:
            raise ValueError(f"it has no column `time`; columns: {', '.join(names)}")
        columns: dict[str, Column] = {}
        for name in names:
            field, values = table.schema.field(name), table.column(name)
            unit = (field.metadata or {}).get(b"unit", b"").decode()
            is_text = pyarrow.types.is_string(field.type) or pyarrow.types.is_large_string(field.type)
            numbers_or_texts = values.to_pylist() if is_text else values.to_numpy().astype(np.float64)
            columns[name] = coded(unit, numbers_or_texts) if is_text else Column(unit, numbers_or_texts)
    except (OSError, TypeError, ValueError, pyarrow.ArrowException) as error:
        raise SignalFileError(f"{path} is no table of signals: {' '.join(str(error).split())}") from error
    if (time := columns.pop("time")).texts is not None:
        raise SignalFileError(f"{path} is no table of signals: its column `time` has texts")
    return _ascending(time.values, path, 1), columns


Write = Callable[[Path, RealArray, Mapping[str, Column], About], Path]
"""Writes times (N,) [s], signals and metadata into a file."""

WRITERS: Mapping[str, tuple[str, Write]] = {
    "csv": ("numpy", write_csv),
    "parquet": ("pyarrow", write_parquet),
    "mat": ("scipy.io", write_mat),
    "mcap": ("mcap", write_mcap),
}
"""Suffix → library that must be installed, and what writes the file."""


def check_format(name: str) -> Write:
    """Return what writes a format, with its library loaded, so that no run is lost by a missing one.

    Raises:
        InputError: there is no such format, or its library isn't installed.
    """
    if name not in WRITERS:
        raise InputError(f"there is no format {name!r} of results; choose from {', '.join(WRITERS)}")
    library, write = WRITERS[name]
    with extra(name):
        import_module(library)
    return write
