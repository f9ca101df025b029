"""Recordings in other tools' forms: each tool reads back every digit, names and units."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from flexfmu.cosim.engine.columns import coded
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.formats import valid_names
from flexfmu.cosim.engine.master.outcome import Outcome, Simulation
from flexfmu.cosim.engine.results import Column, Recording

NUMBERS = np.array([1.0, 1.0 / 3.0, -1e-300, 2e5])


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Signals with a jump at 0.1 s, names that no tool takes as they are, and texts."""
    columns = {
        "joint1.torque": Column("N.m", NUMBERS, first=np.zeros(4)),
        "der(link11.bending[1],2)": Column("m/s2", np.array([0.0, np.nan, np.inf, 3.0])),
        "valve.said": coded("", ["open", "", "größer", "open"]),
    }
    return Recording(np.array([0.0, 0.1, 0.1, 0.2 / 3.0 + 0.2]), columns)


def same(found: Recording, expected: Recording) -> bool:
    """Whether times, names, values, texts and units are equal."""
    assert list(found.columns) == list(expected.columns)
    np.testing.assert_array_equal(found.time, expected.time)
    for name, column in expected.columns.items():
        np.testing.assert_array_equal(found[name].listed(), column.listed())
    return all(found[name].unit == column.unit for name, column in expected.columns.items())


def test_pandas(recording: Recording) -> None:
    """The index is the time, both sides of a jump included, and the frame knows the units."""
    frame = recording.to_pandas()
    assert frame.index.name == "time"
    np.testing.assert_array_equal(frame.index, recording.time)
    np.testing.assert_array_equal(frame["joint1.torque"], NUMBERS)
    assert list(frame["valve.said"]) == ["open", "", "größer", "open"]
    assert frame.attrs["units"]["der(link11.bending[1],2)"] == "m/s2"
    assert list(recording.to_pandas("joint*")) == ["joint1.torque"]
    assert list(recording.to_pandas(["*[1]*", "joint1.torque"])) == ["der(link11.bending[1],2)", "joint1.torque"]
    with pytest.raises(InputError, match=r"no signal 'joint1\.torqe'; did you mean 'joint1\.torque'\?"):
        recording.to_pandas("joint1.torqe")


def test_xarray(recording: Recording) -> None:
    """Every variable has its unit."""
    data = recording.to_xarray()
    np.testing.assert_array_equal(data["time"], recording.time)
    np.testing.assert_array_equal(data["joint1.torque"], NUMBERS)
    assert data["joint1.torque"].attrs["units"] == "N.m"


def test_parquet(recording: Recording, tmp_path: Path) -> None:
    """pandas and pyarrow read the file, with units in the fields' metadata; equal recordings give equal files."""
    import pandas
    from pyarrow import parquet

    path = recording.write(tmp_path / "new" / "results.parquet", {"scene": "mine"})
    assert path.read_bytes() == recording.write(tmp_path / "again.parquet", {"scene": "mine"}).read_bytes()
    assert list(pandas.read_parquet(path)["valve.said"]) == ["open", "", "größer", "open"]
    schema = parquet.read_schema(path)
    assert schema.field("joint1.torque").metadata == {b"unit": b"N.m"}
    assert schema.metadata[b"scene"] == b"mine"
    assert same(Recording.read(path), recording)


def test_mat(recording: Recording, tmp_path: Path) -> None:
    """SciPy reads column vectors with valid names, whose recorded names and units are in the file too."""
    from scipy.io import loadmat

    path = recording.write(tmp_path / "results.mat", {"scene": "mine"})
    assert path.read_bytes() == recording.write(tmp_path / "again.mat", {"scene": "mine"}).read_bytes()
    found = loadmat(path)
    assert found["joint1_torque"].shape == (4, 1)
    np.testing.assert_array_equal(found["joint1_torque"][:, 0], NUMBERS)
    assert [str(each[0]) for each in found["valve_said"][:, 0] if each.size] == ["open", "größer", "open"]
    found = loadmat(path, simplify_cells=True)
    assert found["names"]["der_link11_bending_1_2"] == "der(link11.bending[1],2)"
    assert found["units"]["der_link11_bending_1_2"] == "m/s2"
    assert "scene: mine" in found["about"]
    assert "appears twice" in found["about"]
    assert same(Recording.read(path), recording)


def test_names_in_matlab_are_valid_and_different() -> None:
    """Keywords, names of what else is in the file, equal beginnings and digits at the start are changed."""
    names = ["a.b", "a_b", "end", "time", "1st", "".join(["x"] * 70), "".join(["x"] * 71), "größe"]
    found = valid_names(names)
    assert list(found.values())[:5] == ["a_b", "a_b_v2", "end_v2", "time_v2", "x_1st"]
    assert all(each.isidentifier() and each.isascii() and len(each) <= 63 for each in found.values())
    assert len(set(found.values())) == len(names)


def test_mcap(recording: Recording, tmp_path: Path) -> None:
    """The messages carry JSON at the simulation's time, with names and units in their schema."""
    from mcap.reader import make_reader

    path = recording.write(tmp_path / "results.mcap", {"scene": "mine"})
    with path.open("rb") as file:
        reader = make_reader(file)
        messages = list(reader.iter_messages())
        metadata = {each.name: each.metadata for each in reader.iter_metadata()}
    assert [message.log_time for _, channel, message in messages if channel.topic == "/joint1"] == [
        0,
        100_000_000,
        100_000_000,
        266_666_667,
    ]
    values = [json.loads(message.data) for _, channel, message in messages if channel.topic == "/joint1"]
    np.testing.assert_array_equal([each["torque"] for each in values], NUMBERS)
    schema, channel, message = next(each for each in messages if each[1].topic == "/link11")
    assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
    (field, described) = next(iter(json.loads(schema.data)["properties"].items()))
    assert described["title"] == "der(link11.bending[1],2)"
    assert described["description"] == "m/s2"
    assert json.loads(message.data) == {field: 0.0}
    assert [json.loads(each.data)[field] for _, where, each in messages if where.topic == "/link11"][1:3] == [None] * 2
    assert metadata["units"]["joint1.torque"] == "N.m"
    assert metadata["flexfmu"]["scene"] == "mine"


def test_plot(recording: Recording) -> None:
    """A pair of axes for each unit; notebooks get a picture."""
    figure = recording.plot(["joint1.torque", "der(link11.bending[1],2)"])
    assert [axes.get_ylabel() for axes in figure.axes] == ["[N·m]", "[m/s²]"]
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), NUMBERS)
    assert recording.plot("joint*")._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]


def test_missing_libraries(recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error says what to install."""
    for module in ("pandas", "pyarrow"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=r'pandas isn.t installed; run: pip install "flexfmu\[pandas\]"'):
        recording.to_pandas()
    with pytest.raises(InputError, match=r'pyarrow isn.t installed; run: pip install "flexfmu\[parquet\]"'):
        recording.write(tmp_path / "results.parquet")


@pytest.mark.parametrize("name", ["results.parquet", "results.mat"])
def test_broken_files(name: str, tmp_path: Path) -> None:
    """A file that is none of its format is an error with its path."""
    (tmp_path / name).write_text("no results")
    with pytest.raises(ResultsError, match=f"can't read .*{name}"):
        Recording.read(tmp_path / name)


def test_reprs_are_short(recording: Recording) -> None:
    """At most five lines of at most 80 characters, however many signals there are."""
    many = Recording(np.arange(3.0), {f"link.very_long_signal_name[{i}]": Column("m", np.ones(3)) for i in range(500)})
    ended = Simulation(many, Outcome.COMPLETED, Outcome.COMPLETED.value, None, 1000, 0, ())
    for shown in (recording, many, recording["joint1.torque"], recording["valve.said"], ended):
        lines = repr(shown).splitlines()
        assert len(lines) <= 5
        assert max(map(len, lines)) <= 80
    assert "… 49" in repr(many)
    assert "<td>joint1.torque</td><td>N·m</td>" in recording._repr_html_()
