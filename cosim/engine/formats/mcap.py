"""MCAP files of signals for Foxglove and PlotJuggler: messages in JSON with a JSON Schema, log times from simulation time.

There is a channel for each part, such as ``/joint1`` and ``/link11``, with a message at every instant. ``link11.bending[1]`` is
the field ``bending_1`` of ``/link11``; the schema has the recorded name of a field as its title and the unit as its description.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from mcap.writer import Writer
from pydantic_core import to_json

from flexfmu.cosim.engine.columns import TWICE, Column
from flexfmu.cosim.engine.files import replacing
from flexfmu.cosim.engine.formats.mat import valid_names
from flexfmu.cosim.engine.slave import RealArray

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
            schema = writer.register_schema(f"flexfmu.{part}", "jsonschema", _schema(names, signals))
            identifiers.append(writer.register_channel(f"/{part}", "json", schema))
            tables.append((names, [column.listed() for column in signals.values()]))
        # all parts at each instant, in the order of time; some thousand instants at once, which takes little memory
        for begin in range(0, time.size, PIECE):
            pieces = [_rows(columns, slice(begin, begin + PIECE)) for _, columns in tables]
            for i, stamp in enumerate(stamps[begin : begin + PIECE]):
                for identifier, (names, _), rows in zip(identifiers, tables, pieces, strict=True):
                    data = to_json(dict(zip(names, rows[i], strict=True)), inf_nan_mode="null")
                    writer.add_message(identifier, stamp, data, stamp, sequence=begin + i)
        writer.add_metadata("flexfmu", {**about, "jumps": TWICE})
        writer.add_metadata("units", {name: column.unit for name, column in columns.items()})
        writer.finish()
    return path


def _rows(columns: Sequence[RealArray | list[str]], piece: slice) -> list[tuple[float | str, ...]]:
    """Return the values of some signals at each instant of a piece."""
    cut = [each[piece] if isinstance(each, list) else each[piece].tolist() for each in columns]
    return list(zip(*cut, strict=True))


def _part(name: str) -> str:
    """Return the part that a signal belongs to: ``link11`` for ``der(link11.bending[1],2)``."""
    return name.removeprefix("der(").partition(".")[0]


def _field(name: str, part: str) -> str:
    """Return a signal's name within its part."""
    return name.replace(f"{part}.", "", 1)


def _schema(names: list[str], signals: Mapping[str, Column]) -> bytes:
    """Return the JSON Schema of a part's messages."""
    properties = {
        field: {
            "type": "string" if column.texts is not None else ["number", "null"],
            "title": name,
            "description": column.unit,
        }
        for field, (name, column) in zip(names, signals.items(), strict=True)
    }
    return json.dumps({"type": "object", "properties": properties}).encode()
