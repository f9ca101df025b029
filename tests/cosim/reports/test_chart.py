"""Charts: curves with their points, spectra with known peaks; poses of the table of frequencies."""

from __future__ import annotations

import json
import re
from base64 import b64decode
from errno import ENOSPC
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.reports import chart
from flexfmu.cosim.reports.figure_style import COLOURS, figure_of, save
from flexfmu.cosim.reports.modes_table import modes_along_path
from flexfmu.cosim.reports.page import Plot
from flexfmu.cosim.reports.spectrum import peak, spectrum, spectrum_panel
from flexfmu.model.scene.file import load_scene


def test_a_picture_that_cannot_be_written_leaves_no_half_file(tmp_path: Path) -> None:
    """A disk that is full in the middle of it is one error, and the picture of an earlier run stays."""

    class Half(Figure):
        def savefig(self, path: Any, **_: Any) -> None:
            Path(path).write_bytes(b"half")
            raise OSError(ENOSPC, "No space left on device")

    (tmp_path / "a.png").write_bytes(b"whole")
    with pytest.raises(ResultsError, match=r"a.png: No space left on device; choose another folder"):
        save(Half, tmp_path / "a")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a.png", b"whole")]


def unpacked(text: str) -> Any:
    """The numbers of an array in a page."""
    return np.frombuffer(b64decode(text), "<f4")


@pytest.mark.parametrize("value", [0.0, 3.0, -2e-9])
def test_a_constant_has_a_picture(value: float) -> None:
    """A curve without extent, and none at all, leave finite coordinates, in the plain picture and in the data; figures are drawn, too."""
    time = np.linspace(0.0, 1.0, 5)
    for curves in ([chart.Curve(time, np.full(5, value))], [], [chart.Curve(time, np.full(5, np.nan))]):
        text = Plot("k", "t", "", (chart.Panel(label="x", curves=curves),)).html(chart.MOST_POINTS)
        plain = re.search(r"<noscript>(.*)</noscript>", text)
        assert plain is not None
        ElementTree.fromstring(f"<div>{plain[1]}</div>")
        assert "nan" not in plain[1]
        assert "inf" not in plain[1]
        (found,) = json.loads(text[text.index("{") : text.rindex("}") + 1])["panels"]
        for given, curve in zip(found["curves"], curves, strict=True):
            np.testing.assert_allclose([unpacked(given[axis]) for axis in "xy"], [curve.x, curve.y], rtol=1e-7)
        for scale in ("", "y"):
            panel = chart.Panel("x", curves, logarithmic=scale, level=np.nan)
            figure_of([Plot("k", "t", "", (panel,))]).savefig(BytesIO())


def test_a_figure_shows_what_the_page_shows() -> None:
    """Curves in the page's colours, legends, levels, marks, texts and scales, plots beside each other with their panels below each other."""
    x = np.linspace(1.0, 2.0, 5)
    curves = [chart.Curve(x, x, "a", chart.SECOND), chart.Curve(x, -x, "b", "#102030", 0.0, dot="cross")]
    area = chart.Curve(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 2.0]), fill=0.2)
    above = chart.Panel("u [m]", curves, level=0.5, marks=[(1.5, "end")], limits=(1.0, 1.8))
    below = chart.Panel("v", curves[:1], [chart.Marker(1.2, 1.3, 5.0, text="here")], logarithmic="y", least=0.5)
    plots = [
        Plot("p", "One", "", (above, below)),
        Plot("q", "Two", "", (chart.Panel("y", [area], is_to_scale=True),), "x"),
    ]
    assert figure_of([], "None", 2).axes == []
    one, two, three = figure_of(plots, "Both", 2).axes
    assert [one.lines[0].get_color(), one.lines[1].get_color()] == [COLOURS[chart.SECOND], "#102030"]
    assert [one.lines[1].get_marker(), one.lines[1].get_linestyle()] == ["x", "None"]
    assert (one.get_xlim(), two.get_xlim(), one.get_ylabel()) == ((1.0, 1.8), (1.0, 1.8), "u [m]")
    assert (one.get_xlabel(), two.get_xlabel(), three.get_xlabel()) == ("", "time [s]", "x")
    assert [[text.get_text() for text in axes.texts] for axes in (one, two)] == [["end"], ["here"]]
    assert all(text.get_path_effects() for text in one.texts)  # readable in front of lines
    assert (two.get_yscale(), two.get_ylim()[0] >= 0.5) == ("log", True)
    legend = one.get_legend()
    assert legend is not None
    assert [legend.get_title().get_text(), *(text.get_text() for text in legend.get_texts())] == ["One", "a", "b"]
    assert (three.get_title("left"), len(three.patches), three.get_aspect()) == ("Two", 1, 1.0)


@pytest.mark.parametrize("count", [1, 5, chart.MOST_POINTS, chart.MOST_POINTS + 1, 3 * chart.MOST_POINTS + 7, 100_001])
def test_a_thinned_curve_keeps_ends_and_extremes(count: int) -> None:
    """And isn't longer than stated; values that aren't finite stay, and don't hide others."""
    y = np.random.default_rng(count).normal(size=count)
    chosen = chart.thinned(y)
    assert len(chosen) <= chart.MOST_POINTS
    assert np.all(np.diff(chosen) > 0)
    assert {0, count - 1, int(y.argmin()), int(y.argmax())} <= set(chosen.tolist())
    assert (chart.spread(count)[0], chart.spread(count)[-1]) == (0, count - 1)
    y[count // 3 : count // 2] = np.nan
    assert np.nanmax(y[chart.thinned(y)]) == np.nanmax(y)
    assert np.isnan(y[chart.thinned(y)]).any() == (count > 1)


@pytest.mark.parametrize("frequency", [41.3, 58.0, 77.77])
@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_a_sine_peaks_at_its_frequency_with_its_amplitude(frequency: float, phase: float) -> None:
    """Whether or not it lasts a whole number of periods, on top of a mean, and without what was before."""
    time = np.arange(0.0, 1.0, 2e-4)
    values = 3.0 + 2.5 * np.sin(2.0 * np.pi * frequency * time + phase)
    values[time < 0.4] = 100.0
    found = spectrum(time, values, 0.4)
    assert found is not None
    at, height = peak(*found)
    assert at == pytest.approx(frequency, abs=0.05)
    assert height == pytest.approx(2.5, rel=2e-3)


def test_unequal_steps_and_double_instants_change_nothing() -> None:
    """A recording has jumps twice, and steps that were chosen."""
    rng = np.random.default_rng(1)
    time = np.sort(np.concatenate([np.linspace(0.0, 0.5, 4001), rng.uniform(0.0, 0.5, 2000), [0.25, 0.25]]))
    found = spectrum(time, np.sin(2.0 * np.pi * 30.0 * time), 0.0)
    assert found is not None
    assert peak(*found) == (pytest.approx(30.0, abs=0.05), pytest.approx(1.0, rel=3e-3))


def test_too_little_is_no_spectrum() -> None:
    """A run that ends with its motion, and values that aren't finite."""
    time = np.linspace(0.0, 1.0, 100)
    assert spectrum(time, time, 0.99) is None
    assert spectrum(time, np.full(100, np.nan), 0.0) is None
    assert spectrum_panel("y", []).curves == ()


def test_the_panel_names_its_highest_peak() -> None:
    """And leaves out what lies three decades below."""
    time = np.arange(0.0, 2.0, 1e-3)
    found = spectrum(time, np.sin(2.0 * np.pi * 60.0 * time) + 1e-5 * np.sin(2.0 * np.pi * 300.0 * time), 0.0)
    assert found is not None
    panel = spectrum_panel("y", [chart.Curve(*found)], [(59.0, "mode 1"), (400.0, "mode 2")])
    assert panel.markers[0].text == "60 Hz"
    assert panel.limits is not None
    assert 60.0 < panel.limits[1] < 200.0
    assert [text for _, text in panel.marks] == ["mode 1"]


def test_what_has_no_two_periods_in_the_window_is_no_vibration() -> None:
    """A drift has its peak at about the window's own period, which has no name."""
    time = np.arange(0.0, 0.25, 1e-3)
    found = spectrum(time, np.exp(-time / 0.1), 0.0)
    assert found is not None
    assert spectrum_panel("y", [chart.Curve(*found)], window=0.25).markers == []
    found = spectrum(time, np.sin(2.0 * np.pi * 12.0 * time), 0.0)
    assert found is not None
    assert spectrum_panel("y", [chart.Curve(*found)], window=0.25).markers[0].text.startswith("12")


def test_angles_do_not_jump_where_a_leg_points_left() -> None:
    """Beside the base the path crosses the direction in which arc tangents jump by a turn; the motors do not."""
    rigid = {"effects.proximal_bending": 0, "effects.distal_axial": 0, "effects.damping": "none"}
    path = {"trajectory.start": [-0.35, 0.02], "trajectory.height": 0.04, "trajectory.width": 0.08}
    blend = {"trajectory.blend": {"kind": "lame", "height": 0.02, "width": 0.02}}
    beside = load_scene("barnard2012-6kg").replace({**rigid, **path, **blend})
    poses = modes_along_path(plan(beside), 21)
    assert min(pose.y for pose in poses) < 0.0 < max(pose.y for pose in poses)
    angles = np.array([(pose.q11, pose.q21) for pose in poses])
    assert np.abs(np.diff(angles, axis=0)).max() < 0.1
    assert all(pose.frequencies == () for pose in poses)
