"""Recordings: jumps have two sides, and other tools read back every digit, names and units."""

from __future__ import annotations

import csv
import json
import os
import pickle
import sys
from pathlib import Path
from typing import Any

import fmpy.util
import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import csc_array

from flexfmu.cosim.engine.columns import coded
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.formats import valid_names
from flexfmu.cosim.engine.master.outcome import Outcome, Simulation
from flexfmu.cosim.engine.results import Column, LazyColumns, Recording
from flexfmu.cosim.engine.showing import csv_text

NUMBERS = np.array([1.0, 1.0 / 3.0, -1e-300, 2e5])


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Two signals, with names that no tool takes as they are, one of which jumps at 0.1 s."""
    time = np.array([0.0, 0.1, 0.1, 0.2 / 3.0 + 0.2])
    torque = Column("N.m", NUMBERS, first=np.zeros(4))
    return Recording(time, {"joint1.torque": torque, "der(link11.bending[1],2)": Column("m/s2", np.arange(4.0))})


@pytest.fixture(scope="module")
def foreign(recording: Recording) -> Recording:
    """The same with numbers and texts that other tools may lose."""
    said = coded("", ["open", "", "größer", "open"])
    numbers = Column("m/s2", np.array([0.0, np.nan, np.inf, 3.0]))
    return recording.with_columns({"der(link11.bending[1],2)": numbers, "valve.said": said})


def test_fmpy_reads_what_we_write(recording: Recording, tmp_path: Path) -> None:
    """Our file is the one that fmpy itself would write; it and we get every digit, ``time`` first. A comma in a name, at
    which fmpy would split, is a semicolon."""
    ours = recording.write_csv(tmp_path / "new" / "results.csv")
    table = fmpy.util.read_csv(ours)
    assert table.dtype.names == ("time", "joint1.torque", "der(link11.bending[1];2)")
    np.testing.assert_array_equal(table["time"], recording.time)
    np.testing.assert_array_equal(table["joint1.torque"], recording["joint1.torque"].values)
    fmpy.util.write_csv(tmp_path / "theirs.csv", table)
    assert ours.read_bytes() == (tmp_path / "theirs.csv").read_bytes()
    assert ours.read_text().splitlines()[2:4] == ["0.1,0.3333333333333333,1.0", "0.1,-1e-300,2.0"]
    assert list(Recording.read_csv(ours).columns) == list(recording.columns)


TEXTS = ["plain", 'from, "p"', "two\nlines", "", '"', "\r\n;"]


def test_texts_are_written_as_rfc_4180_has_them(recording: Recording, tmp_path: Path) -> None:
    """Commas, quotes and line breaks arrive in any reader of CSV, in ours too, with every digit of the numbers."""
    numbers = np.array([1.0 / 3.0, -1e-300, 0.1 + 0.2, 2e5, np.pi, 1.0])
    columns = {"said": Column("", np.arange(6.0), texts=TEXTS), "x": Column("m", numbers)}
    path = Recording(np.arange(6.0), columns).write_csv(tmp_path / "texts.csv")
    with open(path, newline="", encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    assert names == ["time", "said", "x"]
    assert [row[1] for row in rows] == TEXTS
    again = Recording.read_csv(path)
    assert [again["said"].text_at(index) for index in range(6)] == TEXTS
    np.testing.assert_array_equal(again["x"].values, numbers)
    assert again["x"].texts is None
    with pytest.raises(ResultsError, match="no texts"):
        again["x"].text_at(0)


def test_pieces_between_jumps(recording: Recording) -> None:
    """Both sides of a jump belong to different pieces."""
    assert [(piece.start, piece.stop) for piece in recording.smooth_pieces()] == [(0, 2), (2, 4)]


def test_a_failed_write_leaves_the_old_file(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk costs neither the old results nor leaves half a file behind."""
    path = recording.write_csv(tmp_path / "results.csv")
    before = path.read_text()

    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(ResultsError, match="No space left on device; choose another folder"):
        recording.write_csv(path)
    assert path.read_text() == before
    assert os.listdir(tmp_path) == ["results.csv"]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("none.csv", None, ""),
        ("text.csv", "no numbers\nat all\n", ""),
        ("other.csv", '"x","time"\n1,2\n', ""),
        ("ragged.csv", '"time","x"\n1,"a"\n2\n', ""),
        ("mixed.csv", '"time","x"\n1,2\n2,"a"\n', ""),
        ("back.csv", '"time","x"\n0,1\n2,1\n1,1\n', ", line 4: 1 s comes after 2 s"),
        ("nan.csv", '"time","x"\n0,1\nnan,1\n', ", line 3: nan s is no time"),
        ("empty.csv", '"time","x"\n', " .* it has no rows"),
        ("results.parquet", "no results", ""),
        ("results.mat", "no results", ""),
    ],
)
def test_unreadable_files(name: str, text: str | None, message: str, tmp_path: Path) -> None:
    """What is no table of signals is refused in one line with its path, and the line where times run backwards; those that repeat
    are jumps."""
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(ResultsError, match=name + message):
        Recording.read(tmp_path / name)


def test_a_recording_is_a_mapping_from_names(recording: Recording) -> None:
    """It iterates over names, as a dict does, and an unknown name isn't in it."""
    assert list(recording) == [*recording.columns] == ["joint1.torque", "der(link11.bending[1],2)"]
    assert [each in recording for each in ("joint1.torque", "joint2.torque", 0)] == [True, False, False]
    assert dict(recording.items()) == recording.columns
    assert Recording(recording.time, {})


def test_every_number_reads_back(tmp_path: Path) -> None:
    """Shortest digits, from the smallest to the largest number, with signed zeros, infinities and not-a-number."""
    special = [0.0, -0.0, np.nan, np.inf, -np.inf, 5e-324, 1.7976931348623157e308, 1e16, -1e22, 1e-5, 0.1]
    bits = np.random.default_rng(1).integers(0, 2**64, 5000, dtype=np.uint64).view(np.float64)
    values = np.concatenate([special, bits])
    path = Recording(np.arange(float(values.size)), {"x": Column("m", values)}).write_csv(tmp_path / "results.csv")
    np.testing.assert_array_equal(Recording.read_csv(path)["x"].values, values)
    assert np.array_equal(np.signbit(Recording.read_csv(path)["x"].values[:2]), [False, True])
    digits = [cell.partition(",")[2] for cell in path.read_text().splitlines()[1:]]
    assert all(float(cell) == value or value != value for cell, value in zip(digits, values.tolist(), strict=True))
    assert max(map(len, digits)) <= 25


def test_lazy_columns_are_made_once_and_copied_whole() -> None:
    """One is made when it is asked for, a pickle has all, and an unknown name is none of them."""
    made: list[str] = []

    def make(name: str) -> Column:
        made.append(name)
        return Column("m", np.arange(3.0))

    recording = Recording(np.arange(3.0), LazyColumns(["a", "b"], make))
    assert "c" not in recording.columns
    assert recording["a"] is recording["a"]
    assert made == ["a"]
    copied = pickle.loads(pickle.dumps(recording))
    assert made == ["a", "b"]
    assert [*copied.columns] == [*recording.columns]
    with pytest.raises(KeyError, match="no signal 'c'"):
        recording["c"]


def same(found: Recording, expected: Recording) -> bool:
    """Whether times, names, values, texts and units are equal."""
    assert list(found.columns) == list(expected.columns)
    np.testing.assert_array_equal(found.time, expected.time)
    for name, column in expected.columns.items():
        np.testing.assert_array_equal(found[name].listed(), column.listed())
    return all(found[name].unit == column.unit for name, column in expected.columns.items())


def test_frames(foreign: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    """The index is the time, both sides of a jump included, and frames and data sets know the units; without pandas the
    error says what to install."""
    frame = foreign.to_pandas()
    assert frame.index.name == "time"
    np.testing.assert_array_equal(frame.index, foreign.time)
    np.testing.assert_array_equal(frame["joint1.torque"], NUMBERS)
    assert list(frame["valve.said"]) == ["open", "", "größer", "open"]
    data = foreign.to_xarray()
    np.testing.assert_array_equal(data["time"], foreign.time)
    np.testing.assert_array_equal(data["joint1.torque"], NUMBERS)
    assert data["joint1.torque"].attrs["units"] == "N.m"
    assert frame.attrs["units"]["der(link11.bending[1],2)"] == "m/s2"
    assert list(foreign.to_pandas("joint*")) == ["joint1.torque"]
    assert list(foreign.to_pandas(["*[1]*", "joint1.torque"])) == ["der(link11.bending[1],2)", "joint1.torque"]
    with pytest.raises(InputError, match=r"no signal 'joint1\.torqe'; did you mean 'joint1\.torque'\?"):
        foreign.to_pandas("joint1.torqe")
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r'pandas isn.t installed; run: pip install "flexfmu\[pandas\]"'):
        foreign.to_pandas()


def test_parquet(foreign: Recording, tmp_path: Path) -> None:
    """pandas and pyarrow read the file, with units in the fields' metadata; equal recordings give equal files."""
    import pandas
    from pyarrow import parquet

    path = foreign.write(tmp_path / "new" / "results.parquet", {"scene": "mine"})
    assert path.read_bytes() == foreign.write(tmp_path / "again.parquet", {"scene": "mine"}).read_bytes()
    assert list(pandas.read_parquet(path)["valve.said"]) == ["open", "", "größer", "open"]
    schema = parquet.read_schema(path)
    assert schema.field("joint1.torque").metadata == {b"unit": b"N.m"}
    assert schema.metadata[b"scene"] == b"mine"
    assert same(Recording.read(path), foreign)


def test_mat(foreign: Recording, tmp_path: Path) -> None:
    """SciPy reads column vectors with valid names, whose recorded names and units are in the file too."""
    from scipy.io import loadmat

    path = foreign.write(tmp_path / "results.mat", {"scene": "mine"})
    assert path.read_bytes() == foreign.write(tmp_path / "again.mat", {"scene": "mine"}).read_bytes()
    found = loadmat(path)
    assert found["joint1_torque"].shape == (4, 1)
    np.testing.assert_array_equal(found["joint1_torque"][:, 0], NUMBERS)
    assert [str(each[0]) for each in found["valve_said"][:, 0] if each.size] == ["open", "größer", "open"]
    found = loadmat(path, simplify_cells=True)
    assert found["names"]["der_link11_bending_1_2"] == "der(link11.bending[1],2)"
    assert found["units"]["der_link11_bending_1_2"] == "m/s2"
    assert "scene: mine" in found["about"]
    assert "appears twice" in found["about"]
    assert same(Recording.read(path), foreign)


def test_names_in_matlab_are_valid_and_different() -> None:
    """Keywords, names of what else is in the file, equal beginnings and digits at the start are changed."""
    names = ["a.b", "a_b", "end", "time", "1st", "".join(["x"] * 70), "".join(["x"] * 71), "größe"]
    found = valid_names(names)
    assert list(found.values())[:5] == ["a_b", "a_b_v2", "end_v2", "time_v2", "x_1st"]
    assert all(each.isidentifier() and each.isascii() and len(each) <= 63 for each in found.values())
    assert len(set(found.values())) == len(names)


def test_mcap(foreign: Recording, tmp_path: Path) -> None:
    """The messages carry JSON at the simulation's time, with names and units in their schema."""
    from mcap.reader import make_reader

    path = foreign.write(tmp_path / "results.mcap", {"scene": "mine"})
    with path.open("rb") as file:
        reader = make_reader(file)
        messages = list(reader.iter_messages())
        metadata = {each.name: each.metadata for each in reader.iter_metadata()}
    torques = [message for _, channel, message in messages if channel.topic == "/joint1"]
    assert [each.log_time for each in torques] == [0, 100_000_000, 100_000_000, 266_666_667]
    np.testing.assert_array_equal([json.loads(each.data)["torque"] for each in torques], NUMBERS)
    schema, channel, message = next(each for each in messages if each[1].topic == "/link11")
    assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
    (field, described) = next(iter(json.loads(schema.data)["properties"].items()))
    assert (described["title"], described["description"]) == ("der(link11.bending[1],2)", "m/s2")
    assert json.loads(message.data) == {field: 0.0}
    assert [json.loads(each.data)[field] for _, where, each in messages if where.topic == "/link11"][1:3] == [None] * 2
    assert metadata["units"]["joint1.torque"] == "N.m"
    assert metadata["flexfmu"]["scene"] == "mine"


def test_plot(foreign: Recording) -> None:
    """A pair of axes for each unit; notebooks get a picture."""
    figure = foreign.plot(["joint1.torque", "der(link11.bending[1],2)"])
    assert [axes.get_ylabel() for axes in figure.axes] == ["[N·m]", "[m/s²]"]
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), NUMBERS)
    assert foreign.plot("joint*")._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]


def test_reprs_are_short(foreign: Recording) -> None:
    """At most five lines of at most 80 characters, however many signals there are."""
    many = Recording(np.arange(3.0), {f"link.very_long_signal_name[{i}]": Column("m", np.ones(3)) for i in range(500)})
    ended = Simulation(many, Outcome.COMPLETED, Outcome.COMPLETED.value, None, 1000, 0, ())
    for shown in (foreign, many, foreign["joint1.torque"], foreign["valve.said"], ended):
        lines = repr(shown).splitlines()
        assert len(lines) <= 5
        assert max(map(len, lines)) <= 80
    assert "… 49" in repr(many)
    assert "<td>joint1.torque</td><td>N·m</td>" in foreign._repr_html_()


def test_names_do_not_become_formulas(tmp_path: Path) -> None:
    """Names that a spreadsheet would run have an apostrophe in CSV files and come back as they were; a byte-order mark is read."""
    names = ("=1+1", "+a", "-b", "@c", "'=d", "''@e", "f-g", "'h")
    recording = Recording(np.arange(2.0), {name: Column("", np.arange(2.0)) for name in names})
    path = recording.write(tmp_path / "x.csv")
    head = path.read_text(encoding="utf-8").splitlines()[0]
    assert not any(cell.startswith(('"=', '"+', '"-', '"@')) for cell in head.split(","))
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert list(Recording.read(path)) == list(names)
    # tables of variants, cases and candidates
    assert csv_text([{"name": "=1+1", "-x": -1.5}, {"name": "-2", "-x": "+a"}]) == "name,'-x\n'=1+1,-1.5\n-2,'+a\n"


@pytest.mark.parametrize(
    ("kind", "time"),
    [
        *(("parquet", time) for time in ([0.0, 2.0, 1.0], [0.0, np.nan], ["a", "b"])),
        *(("mat", time) for time in ({"a": 1.0}, ["a", {"b": 1.0}], "text", [2.0, 1.0])),
    ],
)
def test_times_of_other_files_are_checked(kind: str, time: Any, tmp_path: Path) -> None:
    """As those of CSV files are: finite numbers that don't decrease; structs, cells and texts are no time."""
    path = tmp_path / f"x.{kind}"
    if kind == "parquet":
        parquet, pyarrow = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow")
        parquet.write_table(pyarrow.table({"time": time, "a": [1.0] * len(time)}), path)
    else:
        savemat(path, {"time": time, "a": [1.0, 2.0]})
    with pytest.raises(ResultsError, match=r"must be finite and not decrease|`time` has texts|mat"):
        Recording.read(path)


def test_mat_files_by_others_are_read_as_scipy_reads_them(tmp_path: Path) -> None:
    """Rows, integers, texts in cells and in tables of characters; what is no signal is left out. A wrong type crashes SciPy."""
    signals = {
        "a": np.array([[0.5, -1.0, 2.0]]),
        "n": np.array([1, 2, 300], dtype=np.int16),
        "b": np.array([True, False, True]),
    }
    texts = {"c": np.array(["on", "", "größer"], dtype=object), "t": np.array(["ab", "cd", "ef"])}
    others = {"z": np.ones(3) * 1j, "m": np.eye(3), "s": {"q": [1.0, 2.0, 3.0]}, "w": csc_array(np.eye(3))}
    for packed in (False, True):
        path = tmp_path / f"{packed}.mat"
        savemat(path, {"time": [0.0, 1.0, 2.0], **signals, **texts, **others}, do_compression=packed)
        read = Recording.read(path)
        assert {*read} == {*signals, *texts}
        assert all(read[name].values.tolist() == np.ravel(values).tolist() for name, values in signals.items())
        assert all(read[name].listed() == values.tolist() for name, values in texts.items())
    content = (tmp_path / "False.mat").read_bytes()
    path.write_bytes(content.replace(b"\x09\0\0\0\x18", b"\x09\x22\0\0\x18"))
    with pytest.raises(ResultsError, match="damaged"):
        Recording.read(path)
    # a kilobyte for each megabyte that it unpacks to
    savemat(path, {"time": np.zeros(10_000_000)}, do_compression=True)
    with pytest.raises(ResultsError, match="unpacks to too much"):
        Recording.read(path)
