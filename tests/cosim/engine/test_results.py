"""Recordings: jumps have two sides, and the CSV file is what fmpy reads."""

from __future__ import annotations

import csv
import os
import pickle
from pathlib import Path

import fmpy.util
import numpy as np
import pytest

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.results import Column, LazyColumns, Recording


@pytest.fixture
def recording() -> Recording:
    """Two signals, one of which jumps at 0.1 s."""
    time = np.array([0.0, 0.1, 0.1, 0.2 / 3.0 + 0.2])
    torque = Column("N.m", np.array([1.0, 1.0 / 3.0, -1e-300, 2e5]), first=np.zeros(4))
    return Recording(time, {"joint1.torque": torque, "der(link11.bending[1],2)": Column("m/s2", np.arange(4.0))})


def test_fmpy_reads_what_we_write(recording: Recording, tmp_path: Path) -> None:
    """Our file is the one that fmpy itself would write; it and we get every digit, ``time`` first. A comma in a name, at
    which fmpy would split, is a semicolon."""
    ours = recording.write_csv(tmp_path / "new" / "results.csv")
    table = fmpy.util.read_csv(ours)
    assert table.dtype.names == ("time", "joint1.torque", "der(link11.bending[1];2)")
    np.testing.assert_array_equal(table["time"], recording.time)
    np.testing.assert_array_equal(table["joint1.torque"], recording["joint1.torque"].values)
    fmpy.util.write_csv(tmp_path / "theirs.csv", table)
    assert ours.read_text() == (tmp_path / "theirs.csv").read_text()
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


def test_numpy_reads_what_we_write(recording: Recording, tmp_path: Path) -> None:
    """numpy's readers get every digit too, of files without texts and of columns beside texts without commas."""
    path = recording.write_csv(tmp_path / "results.csv")
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(table[:, 1], recording["joint1.torque"].values)
    assert path.read_bytes() == (
        b'"time","joint1.torque","der(link11.bending[1];2)"\n0.0,1.0,0.0\n0.1,0.3333333333333333,1.0\n'
        b"0.1,-1e-300,2.0\n0.26666666666666666,200000.0,3.0\n"
    )
    said = Column("", np.zeros(4), texts=["stop; go"])
    named = np.genfromtxt(
        recording.with_columns({"said": said}).write_csv(tmp_path / "said.csv"), delimiter=",", skip_header=1
    )
    np.testing.assert_array_equal(named[:, 1], recording["joint1.torque"].values)


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


def test_unreadable_files(tmp_path: Path) -> None:
    """What is no table of signals is refused in one line."""
    (tmp_path / "text.csv").write_text("no numbers\nat all\n")
    (tmp_path / "other.csv").write_text('"x","time"\n1,2\n')
    (tmp_path / "ragged.csv").write_text('"time","x"\n1,"a"\n2\n')
    (tmp_path / "mixed.csv").write_text('"time","x"\n1,2\n2,"a"\n')
    for name in ("none.csv", "text.csv", "other.csv", "ragged.csv", "mixed.csv"):
        with pytest.raises(ResultsError, match=name):
            Recording.read_csv(tmp_path / name)


def test_lengths_must_agree() -> None:
    """A column that doesn't fit its times is a mistake of the caller."""
    with pytest.raises(ResultsError, match="'x' has 3 values for 2 instants"):
        Recording(np.zeros(2), {"x": Column("m", np.zeros(3))})


def test_a_recording_is_a_mapping_from_names(recording: Recording) -> None:
    """It iterates over names, as a dict does, and an unknown name isn't in it."""
    assert list(recording) == [*recording.columns] == ["joint1.torque", "der(link11.bending[1],2)"]
    assert len(recording) == 2
    assert "joint1.torque" in recording
    assert "joint2.torque" not in recording
    assert 0 not in recording
    assert dict(recording.items()) == recording.columns
    assert recording.get("joint2.torque") is None
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
