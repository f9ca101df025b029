"""Logs: separators, decimal commas, units, factors, and errors that say what to type."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io
from typer.testing import CliRunner

import flexfmu
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.engine.errors import DataWarning, InputError, ResultsError
from flexfmu.cosim.engine.measured import Mapped, as_mapped, parse_mapping, read_log
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.studies.compare.sources import compared_runs

SIGNALS = {"joint1.torque": "N.m", "joint1.position": "rad", "link11.bending[1]": "m"}


def log(tmp_path: Path, text: str) -> Path:
    """A log with this content."""
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    return path


READ: list[tuple[str, list[str], dict[str, list[float]]]] = [
    # equal names, whatever else is in the file; an empty cell is a missing value
    (
        "mode,time,joint1.torque,link11.bending[1]\nauto,0,1,2\nauto,0.1,,3\n",
        [],
        {"time": [0.0, 0.1], "joint1.torque": [1.0, math.nan], "link11.bending[1]": [2.0, 3.0]},
    ),
    # as spreadsheets of half of Europe write it: decimal commas, units in brackets, a byte-order mark and a comment
    (
        "\ufeff# logged by the drive\nT [ms];joint1.torque [mN.m];joint1.position (deg)\n1,5;2000,5;180\n2,5;1e3;90\n",
        [],
        {"time": [1.5e-3, 2.5e-3], "joint1.torque": [2.0005, 1.0], "joint1.position": [math.pi, math.pi / 2.0]},
    ),
    # units in the second line
    ("time\tjoint1.torque\ns\tkN.m\n0\t1\n1\t2\n", [], {"time": [0.0, 1.0], "joint1.torque": [1e3, 2e3]}),
    # names, factors, units and offsets of the user; a factor replaces the unit of the header
    (
        "Zeit,M_1 [%],phi\n0,1,0\n1000,2,90\n",
        ["Zeit=time*ms", "M_1=joint1.torque*0.5+3", "phi=joint1.position*deg"],
        {"time": [0.0, 1.0], "joint1.torque": [3.5, 4.0], "joint1.position": [0.0, math.pi / 2.0]},
    ),
]


@pytest.mark.parametrize(("text", "mapping", "expected"), READ)
def test_logs(tmp_path: Path, text: str, mapping: list[str], expected: dict[str, list[float]]) -> None:
    """Separators, units and names, in SI in the end."""
    found = read_log(log(tmp_path, text), dict(map(parse_mapping, mapping)), SIGNALS)
    np.testing.assert_allclose(found.time, expected.pop("time"))
    assert list(found.columns) == list(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(found[name].values, values)
        assert found[name].unit == SIGNALS[name]


@pytest.mark.parametrize(
    ("text", "mapping", "message"),
    [
        ("x,joint1.torque\n0,1\n", {}, 'no column `time`; map one, --map "x=time"'),
        ("time,x\n0,1\n", {}, 'no column of .* is a signal; map one, --map "x=joint1.torque"'),
        ("time,x\n0,1\n", {"y": "joint1.torque"}, "no column 'y'"),
        ("time,x\n0,1\n", {"x": "joint1.torqe"}, "no such signal; did you mean 'joint1.torque'"),
        ("time,x,y\n0,1,2\n", {"x": "joint1.torque", "y": "joint1.torque"}, "two columns of .* are mapped to"),
        ("time,joint1.torque [V]\n0,1\n", {}, "unknown unit 'V'; give the factor .*joint1.torque=joint1.torque"),
        ("time,joint1.torque\n1,1\n0,2\n", {}, r"line 3: the time in column .time. must not decrease"),
        ("time,joint1.torque\n", {}, "has no rows"),
        ("time,joint1.torque\ns,N.m\n", {}, "has no rows"),
        ("time,joint1.torque\n0,1\n1\n", {}, "line 3: 1 cells for the 2 columns"),
        ("", {}, r"can't read .*nothing\.csv: No such file"),
    ],
)
def test_wrong_logs(tmp_path: Path, text: str, mapping: dict[str, str], message: str) -> None:
    """One line with what, where and what to type."""
    path = log(tmp_path, text) if text else tmp_path / "nothing.csv"
    with pytest.raises((InputError, ResultsError), match=message):
        read_log(path, {name: as_mapped(each) for name, each in mapping.items()}, SIGNALS)


def test_mappings() -> None:
    """Spaces, powers of ten and signs are as in Python; what isn't COLUMN=SIGNAL*FACTOR+OFFSET is refused."""
    assert as_mapped(" joint1.torque * -1e+3 + -2 ") == Mapped("joint1.torque", -1e3, -2.0)
    assert as_mapped("joint1.torque+2") == Mapped("joint1.torque", None, 2.0)
    for text in ("joint1.torque", "=joint1.torque", "x=joint1.torque*two", "x=joint1.torque*nan", "x="):
        with pytest.raises(InputError):
            parse_mapping(text)


def test_our_own_results_are_logs_too(tmp_path: Path) -> None:
    """results.csv, with a comma in a name, and Parquet."""
    name = "der(link11.bending[1],2)"
    recording = Recording(np.arange(3.0), {name: Column("m/s2", np.array([1.0, -2.0, 3.0]))})
    for file in ("results.csv", "results.parquet"):
        found = read_log(recording.write(tmp_path / file), {}, {name: "m/s2"})
        np.testing.assert_array_equal(found[name].values, [1.0, -2.0, 3.0])


def test_what_is_no_number_is_told_by_line(tmp_path: Path) -> None:
    """Samples that are infinite or no numbers are left out with a warning, empty cells without; a byte-order mark is read."""
    path = log(tmp_path, "\ufeff# drive 1\ntime,joint1.torque,other\n0,1,x\n1,inf,x\n2,,x\n3,nan,x\n")
    with pytest.warns(DataWarning, match=r"2 values are no finite numbers .* 'inf' in line 4, column 'joint1.torque'"):
        read_log(path, {}, SIGNALS)
    with pytest.raises(
        InputError, match=r"numbers; the first is 'inf' in line 4, column 'joint1.torque'; without --strict"
    ):
        read_log(path, {}, SIGNALS, strict=True)


def test_a_file_of_results_is_looked_at_too(tmp_path: Path) -> None:
    """What is no finite number in it is left out and told by line, or refused."""
    path = log(tmp_path, "time,joint1.torque\n0,1\n1,inf\n2,nan\n3,4\n")
    with pytest.warns(
        DataWarning, match=r"2 values are no finite numbers and .* 'inf' in line 3, column 'joint1.torque'"
    ):
        (run,) = compared_runs([path])
    np.testing.assert_array_equal(run.recording["joint1.torque"].values, [1.0, np.nan, np.nan, 4.0])
    with pytest.raises(InputError, match="line 3"):
        flexfmu.compare(path, strict=True)


def test_infinities_of_a_data_frame_are_told(tmp_path: Path) -> None:
    """By row, as those of a file; NaN is a missing value there."""
    frame = pd.DataFrame({"time": [0.0, 1.0, 2.0], "a": [1.0, math.inf, math.nan]})
    with pytest.warns(DataWarning, match="1 values are no finite numbers .*'inf' in line 2, column 'a'"):
        read_log(frame, {}, {"a": ""})


def test_files_without_metrics_are_compared_by_signals(tmp_path: Path) -> None:
    """Wrong files are wrong input: exit status 2, and what is wrong."""
    scipy.io.savemat(tmp_path / "object.mat", {"time": np.array([{"a": 1.0}, {"a": 2.0}], dtype=object)})
    texts = {
        "one": "time,a\n0,1\n1,2\n",
        "bom": "\ufefftime,a\n0,1\n1,4\n",
        "b": "time,b\n0,1\n1,2\n",
        "back": "time,a\n1,1\n0,2\n",
    }
    for name, text in texts.items():
        log(tmp_path, text).rename(tmp_path / f"{name}.csv")

    def told(name: str) -> tuple[int, str]:
        ran = CliRunner().invoke(app, ["compare", str(tmp_path / "one.csv"), str(tmp_path / name)])
        return ran.exit_code, " ".join(ran.output.split())

    status, text = told("bom.csv")
    assert status == 0
    assert "bom minus one" in text
    assert "1.414" in text
    for name, problem in {
        "b.csv": "no metrics", "back.csv": "line 3: 0 s comes after 1 s", "object.mat": "its `time` is no vector of real numbers",
    }.items():  # fmt: skip
        status, text = told(name)
        assert status == 2
        assert problem in text
