"""MAT files of signals for MATLAB and Octave, by SciPy in version 5 of the format.

Every signal is a column vector beside ``time``. Its name is made a valid one: ``link11.bending[1]`` is ``link11_bending_1``. The
structs ``names`` and ``units`` have the recorded name and the unit of each variable, and ``about`` says what is in the file.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.io import loadmat, savemat
from scipy.io.matlab import MatReadError

from flexfmu.cosim.engine.columns import TWICE, Column, coded
from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.files import replacing
from flexfmu.cosim.engine.slave import RealArray

LONGEST = 63
"""Largest number of characters of a name in MATLAB (`namelengthmax`)."""

TAKEN = frozenset(
    [
        "time",
        "names",
        "units",
        "about",
        "break",
        "case",
        "catch",
        "classdef",
        "continue",
        "else",
        "elseif",
        "end",
        "for",
        "function",
        "global",
        "if",
        "otherwise",
        "parfor",
        "persistent",
        "return",
        "spmd",
        "switch",
        "try",
        "while",
    ]
)
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


def read_mat(path: Path) -> tuple[RealArray, dict[str, Column]]:
    """Return times (N,) [s] and signals of a file by `write_mat`.

    A file of other programs needs a vector ``time``; vectors of its length are signals without units.

    Raises:
        ResultsError: the file can't be read, or has no vector ``time``.
    """
    try:
        found = loadmat(path, simplify_cells=True)
    except (OSError, ValueError, IndexError, NotImplementedError, MatReadError) as error:
        hint = "; save it in MATLAB with -v7" if isinstance(error, NotImplementedError) else ""
        raise ResultsError(f"can't read {path}: {' '.join(str(error).split())}{hint}") from error
    if "time" not in found:
        raise ResultsError(f"{path} is no file of signals: it has no variable `time`")
    time = np.ravel(found["time"]).astype(np.float64)
    names, units = (each if isinstance(each := found.get(key), dict) else {} for key in ("names", "units"))
    columns = {}
    for variable, values in found.items():
        if variable in ("time", "names", "units", "about") or variable.startswith("__") or np.size(values) != time.size:
            continue
        name, unit, values = _text(names.get(variable)) or variable, _text(units.get(variable)), np.ravel(values)
        texts = values.dtype.kind in "OU"
        columns[name] = coded(unit, map(_text, values)) if texts else Column(unit, values.astype(np.float64))
    return time, columns


def _text(value: object) -> str:
    """Return a text of a MAT file; SciPy reads an empty one as an empty array."""
    return value if isinstance(value, str) else ""
