"""Results with rows: the same figures as a data frame, CSV, JSON and in a notebook; the page that compares runs."""

from __future__ import annotations

import json
import pickle
import re
from base64 import b64decode
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.showing import SHOWN, Rows
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.reports.comparison import ComparedRun, compared_plots, comparison_page, metrics_table
from flexfmu.cosim.reports.figure_style import draw
from flexfmu.cosim.reports.modes_table import ModalPose, ModesAlongPath
from flexfmu.cosim.reports.page import Table
from flexfmu.cosim.studies.compare.comparison import compare_runs
from flexfmu.model.scene.file import load_scene


class Runs(Rows):
    """Two runs."""

    row_name = "run"

    def __repr__(self) -> str:
        """What HTML must not take for an element."""
        return "<two runs>"

    def plot(self) -> Figure:
        """An empty figure."""
        return draw(2.0, 1.0)

    def rows(self) -> list[dict[str, Any]]:
        """One of them without a figure."""
        return [{"run": "a", "torque": 1.5}, {"run": "b", "torque": nan}]

    def row_units(self) -> dict[str, str]:
        """Of the only figure."""
        return {"torque": "N.m"}


def test_rows_are_told_in_every_form() -> None:
    """JSON has no NaN; units are where there is room for them."""
    found = Runs()
    frame = found.to_pandas()
    assert (frame.index.name, frame.attrs["units"]) == ("run", {"torque": "N.m"})
    assert frame.loc["a", "torque"] == 1.5
    assert json.loads(found.to_json()) == [{"run": "a", "torque": 1.5}, {"run": "b", "torque": None}]
    assert found.to_csv().splitlines() == ["run,torque", "a,1.5", "b,nan"]
    html = found._repr_html_()
    assert "<th>torque [N·m]</th>" in html
    assert "<td>1.5</td>" in html
    # text, table, picture
    assert html.startswith("<pre>&lt;two runs&gt;</pre>")
    picture = b64decode(html.split('src="data:image/png;base64,')[1].split('"')[0])
    assert picture.startswith(b"\x89PNG")


def test_a_notebook_shows_the_first_rows_without_empty_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    """The others are counted."""
    rows = [{"run": f"r{k}", "torque": float(k), "message": "", "error": None} for k in range(SHOWN + 5)]
    monkeypatch.setattr(Runs, "rows", lambda self: rows)
    html = Runs().html_tables()
    assert html.count("<tr>") == 1 + SHOWN
    assert "5 more" in html
    assert not re.search("message|error", html)
    assert list(Runs().to_pandas().columns) == ["torque", "message", "error"]


def test_signals_that_would_be_flat_have_axes_of_their_own() -> None:
    """A deflection of 0.2 mm beside a path of 350 mm; what is constant stays."""
    t = np.linspace(0.0, 1.0, 50)
    columns = {
        "x": Column("m", 0.35 * t),
        "torque": Column("N.m", t),
        "deflection": Column("m", 2e-4 * np.sin(20.0 * t)),
        "y": Column("m", np.full(50, 0.3)),
    }
    figure = Recording(t, columns).plot(list(columns))
    shown = [" ".join(str(line.get_label()) for line in axes.lines) for axes in figure.axes]
    assert shown == ["x y", "torque", "deflection"]
    assert [axes.get_ylabel() for axes in figure.axes] == ["[m]", "[N·m]", "[mm]"]
    assert np.max(figure.axes[2].lines[0].get_ydata()) == pytest.approx(0.2, rel=1e-2)


def test_many_signals_look_different() -> None:
    """Sixteen of a unit have ten colours."""
    t = np.linspace(0.0, 1.0, 5)
    (axes,) = Recording(t, {f"u{k}": Column("V", k + t) for k in range(16)}).plot().axes
    assert len({(line.get_color(), line.get_linestyle()) for line in axes.lines}) == 16


def test_modes_are_a_list_a_table_and_a_diagram() -> None:
    """Length, index, slices and equality as of a list of poses; copies have the name."""
    poses = [ModalPose(0.5 * k, 0.1 * k, 0.3, 1.0, 2.0, (50.0 + k, 80.0, 2000.0)) for k in range(3)]
    found = ModesAlongPath("robot", poses)
    assert (len(found), found[1], found[-1], [*found]) == (3, poses[1], poses[2], poses)
    assert found == poses
    assert isinstance(found, list)
    frame = found.to_pandas()
    assert list(frame.columns) == ["x", "y", "q11", "q21", "f1", "f2", "f3"]
    assert frame.index.name == "s"
    assert frame.loc[1.0, "f1"] == 52.0
    assert frame.attrs["units"]["f3"] == "Hz"
    assert repr(found).splitlines()[1] == "  f1 50 to 52 Hz, f2 80 to 80 Hz, f3 2000 to 2000 Hz"
    assert [line.get_label() for line in found.plot().axes[0].lines] == ["f1", "f2", "f3"]
    again = pickle.loads(pickle.dumps(found))
    assert (again, again.name) == (found, "robot")
    for rigid in (ModesAlongPath("rigid", [replace(each, frequencies=()) for each in poses]), ModesAlongPath()):
        assert "<img" in rigid._repr_html_()


def test_a_motion_is_a_table_of_instants() -> None:
    """Its rows are those of the trajectories; a notebook shows smallest and largest values."""
    motion = plan(load_scene("barnard2012-6kg"))
    frame = motion.to_pandas()
    time = frame.index.to_numpy()
    assert (time[0], time[-1]) == (0.0, motion.duration)
    expected = motion.joints.evaluate(time, 2, "left")
    np.testing.assert_array_equal(frame["joint2.velocity"], expected[1, :, 1])
    assert frame.attrs["units"]["end_effector.x.acceleration"] == "m/s2"
    shown = {row["signal"]: row for row in motion.shown_rows()}
    assert shown["joint2.velocity [rad/s]"]["largest"] == expected[1, :, 1].max()
    assert len(motion.plot().axes) == 3


TIME = np.linspace(0.0, 0.6, 3001)


def compared(name: str, amplitude: float, count: int = 1) -> ComparedRun:
    """A run that rings at 50 Hz."""
    ringing = amplitude * np.sin(2.0 * np.pi * 50.0 * TIME)
    columns = {f"end_effector.position.{axis}": Column("m", 0.2 + 1e-5 * ringing) for axis in "xy"}
    columns["joint1.torque"] = Column("N.m", 10.0 * ringing)
    metrics = {"peak_torque_1": Metric(10.0 * amplitude), "settling_time": Metric(None)}
    return ComparedRun(name, Recording(TIME, columns), metrics, 0.3)


def test_metrics_stand_beside_each_other_with_differences() -> None:
    """Relative to the first run; no value is a dash."""
    table = metrics_table([compared("slow", 1.0), compared("fast", 1.25), ComparedRun("measured", Recording(TIME, {}))])
    assert table.header == ["Metric", "Name", "slow", "fast", "measured"]
    assert table.rows[0] == ["Peak torque, joint 1", "peak_torque_1", "10 N·m", "12.5 N·m (+25 %)", "–"]
    assert table.rows[1][2:] == ["–", "–", "–"]
    rings = ({"residual_vibration_amplitude": Metric(each)} for each in (1e-6, 3.6e-16))
    still = [replace(compared(name, 1.0), metrics=each) for name, each in zip(("one", "other"), rings, strict=True)]
    assert "other has the least residual vibration, 0 mm. " in comparison_page(still, [], []).verdict
    cells = metrics_table([compared(f"{each}", each) for each in (1.0, 13.456, 0.9)]).rows[0][3:]
    assert cells == ["134.56 N·m (+1250 %)", "9 N·m (−10 %)"]


def test_curves_are_the_recordings() -> None:
    """The values that the page shows are recorded ones, to the 24 bits that it keeps."""
    runs = [compared("slow", 1.0), compared("<fast>", 1.25)]
    text = comparison_page(
        runs, [metrics_table(runs), Table("More", ["", "a"], [["b", "7 %"]])], [*compared_plots(runs)]
    ).html
    first = re.search(r'<script type="application/json">(.*?)</script>', text)
    assert first is not None
    found = {each["label"]: [each["x"], each["y"]] for each in json.loads(first[1])["panels"][0]["curves"]}
    assert set(found) == {"slow", "<fast>"}
    for name, amplitude in (("slow", 1.0), ("<fast>", 1.25)):
        x, y = (np.frombuffer(b64decode(each), "<f4").astype(float) for each in found[name])
        np.testing.assert_allclose(y, 10.0 * amplitude * np.sin(2.0 * np.pi * 50.0 * x), atol=1e-3)
        assert np.isin(x.astype(np.float32), TIME.astype(np.float32)).all()
        assert y.max() == pytest.approx(10.0 * amplitude, rel=1e-6)
    assert "<fast>" not in text
    assert "7 %" in text
    assert text.count("50 Hz") == 2


def test_many_runs_stay_below_the_limit_of_a_page() -> None:
    """Of 1.5 MB; each run has fewer points then."""
    text = compare_runs([compared(f"run {i}", 1.0 + i) for i in range(30)]).page()
    assert len(text.encode()) < 1.5e6


@pytest.mark.slow
def test_the_documented_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """docs/results.md: a page of two runs."""
    text = (Path(__file__).parents[3] / "docs" / "results.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"^```python\n(.*?)^```", text.partition("\n### Compare runs")[2], re.DOTALL | re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "docs/results.md", "exec"), {})
    page = (tmp_path / "comparison" / "comparison.html").read_text(encoding="utf-8")
    assert "Spectra of the residual vibration" in page
    assert re.search(r"\(−\d+\.\d %\)", page)
