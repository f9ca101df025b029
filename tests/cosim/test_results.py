"""Recordings: jumps have two sides, and the CSV file is what fmpy reads."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import fmpy.util
import numpy as np
import pytest

from flexfmu.cosim.errors import ResultsError
from flexfmu.cosim.results import Column, Recording


@pytest.fixture
def recording() -> Recording:
    """Two signals, one of which jumps at 0.1 s."""
    time = np.array([0.0, 0.1, 0.1, 0.2 / 3.0 + 0.2])
    torque = Column("N.m", np.array([1.0, 1.0 / 3.0, -1e-300, 2e5]), first=np.zeros(4))
    return Recording(time, {"joint1.torque": torque, "der(link11.bending[1],2)": Column("m/s2", np.arange(4.0))})


def test_fmpy_reads_what_we_write(recording: Recording, tmp_path: Path) -> None:
    """fmpy gets every digit, ``time`` first; a comma in a name, at which it would split, is a semicolon."""
    table = fmpy.util.read_csv(recording.write_csv(tmp_path / "results.csv"))
    assert table.dtype.names == ("time", "joint1.torque", "der(link11.bending[1];2)")
    np.testing.assert_array_equal(table["time"], recording.time)
    np.testing.assert_array_equal(table["joint1.torque"], recording["joint1.torque"].values)


def test_fmpy_writes_the_same_text(recording: Recording, tmp_path: Path) -> None:
    """Our file is the one that fmpy itself would write."""
    ours = recording.write_csv(tmp_path / "ours.csv")
    fmpy.util.write_csv(tmp_path / "theirs.csv", fmpy.util.read_csv(ours))
    assert ours.read_text() == (tmp_path / "theirs.csv").read_text()


def test_fmpy_plots_what_we_write(recording: Recording, tmp_path: Path) -> None:
    """fmpy plots the file, in each diagram an event line at the jump."""
    table = fmpy.util.read_csv(recording.write_csv(tmp_path / "results.csv"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # plotly's own
        figure = fmpy.util.create_plotly_figure(table, events=True)
    assert len(figure.data) == 2
    assert [shape.x0 for shape in figure.layout.shapes] == [100.0, 100.0]  # ms


def test_round_trip(recording: Recording, tmp_path: Path) -> None:
    """We read our own file back, names and digits."""
    again = Recording.read_csv(recording.write_csv(tmp_path / "new" / "results.csv"))
    assert list(again.columns) == list(recording.columns)
    np.testing.assert_array_equal(again["der(link11.bending[1],2)"].values, np.arange(4.0))


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
    for name in ("none.csv", "text.csv", "other.csv"):
        with pytest.raises(ResultsError, match=name):
            Recording.read_csv(tmp_path / name)


def test_lengths_must_agree() -> None:
    """A column that doesn't fit its times is a mistake of the caller."""
    with pytest.raises(ResultsError, match="'x' has 3 values for 2 instants"):
        Recording(np.zeros(2), {"x": Column("m", np.zeros(3))})


def test_unknown_signals_are_named(recording: Recording) -> None:
    """Asking for a signal that wasn't recorded tells which there are."""
    with pytest.raises(KeyError, match=r"joint1\.torque"):
        recording["torque"]
