"""Diagrams of margins: what one reads from a drawn curve is the number."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blocks import looped
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from flexfmu.cosim.design.margins.margins import ALL
from flexfmu.cosim.design.margins.pictures import disk_of, draw_margins, loop_curves
from flexfmu.cosim.design.margins.scene_margins import MarginsResult, scene_margins, write_margins
from flexfmu.trajectories.jets import RealArray

PD: dict[str, Any] = {"kind": "pd", "proportional": 1e4, "derivative": 60.0, "sample_time": 1e-3}


LOOPS: dict[str, tuple[list[dict[str, Any]], dict[str, float]]] = {
    "single": ([{"kind": "delay", "time": 1e-3, "sample_time": 1e-3}], {"proportional": 2e3, "derivative": 15.0}),
    "several": ([{"kind": "lag", "time_constant": 2e-4}, {"kind": "delay", "time": 3e-4, "sample_time": 2.5e-4}], {}),
    "unstable": ([{"kind": "delay", "time": 5e-3, "sample_time": 1e-3}], {"proportional": 3e4, "derivative": 300.0}),
}
"""One sample time: curves are exact; several ones; and a delay that the gains don't bear."""


@cache
def margins_of(name: str) -> MarginsResult:
    """Those of the paper's robot with few modes and a PD."""
    imperfections, gains = LOOPS[name]
    return scene_margins(looped({**PD, **gains}, *imperfections), poses=2)


def curve_of(axes: Axes) -> tuple[RealArray, RealArray]:
    """The drawn curve of the worst loop: the last one with a colour and many points."""
    lines = [line for line in axes.lines if np.size(line.get_xdata()) > 100 and line.get_zorder() == 3.0]
    assert len(lines) >= 1
    return np.asarray(lines[-1].get_xdata(), float), np.asarray(lines[-1].get_ydata(), float)


def test_margins_are_read_from_the_drawn_curves() -> None:
    """Magnitude where the phase passes -180 degrees, and phase where the magnitude passes 0 dB."""
    single = margins_of("single")
    worst = loop_curves(single.poses)[0].margins
    gain, phase = draw_margins(single.poses, "", nyquist=False).axes[:2]
    frequency, decibels = curve_of(gain)
    _, degrees = curve_of(phase)
    expected = 20.0 * np.log10(worst.gain_margin)
    assert np.abs(-_read(decibels, (degrees + 180.0) / 360.0) - expected).min() < 0.01 * expected
    margins = 180.0 - np.abs(_read(degrees, 1e-4 * decibels) % 360.0)
    assert np.abs(margins).min() == pytest.approx(np.degrees(worst.phase_margin), rel=0.01)
    # and marked there, to scale
    ends = {line.get_zorder(): line for line in gain.lines if np.size(line.get_xdata()) == 2}[4.0]
    (f, _), (top, bottom) = ends.get_data()
    assert (top, bottom) == (0.0, pytest.approx(-expected))
    assert np.interp(f, frequency, decibels) == pytest.approx(-expected, rel=0.01)


def _read(values: RealArray, turns: RealArray) -> RealArray:
    """Values where another curve passes a whole number, linearly between points."""
    k = np.flatnonzero(np.diff(np.floor(turns)))
    share = (np.maximum(np.floor(turns[k]), np.floor(turns[k + 1])) - turns[k]) / (turns[k + 1] - turns[k])
    return np.asarray(values[k] + share * (values[k + 1] - values[k]))


@pytest.mark.parametrize("name", ["single", "several"])
def test_curves_touch_the_disk_and_are_continuous(name: str) -> None:
    """They stay outside of each loop's own disk; with several sample times the margin is a bound, which the curve needn't reach. Phases
    have no jump by a turn, two turns on the axis at most, and -180 degrees among them."""
    result = margins_of(name)
    for curve in loop_curves(result.poses):
        middle, radius = disk_of(curve.margins.disk_margin)
        least = np.abs(curve.response - middle).min()
        assert least > (1.0 - 1e-3) * radius
        assert name == "several" or least < (1.0 + 1e-2) * radius
    # the drawn one is that of the worst
    axes = draw_margins(result.poses, "", bode=False).axes[0]
    disk = next(each for each in axes.patches if isinstance(each, Circle) and each.get_fill())
    assert (disk.center[0], disk.radius) == pytest.approx(
        disk_of(min(row.disk_margin for p in result.poses for row in p.loops if row.channel != ALL))
    )
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    assert left < -1.0 < right
    assert low < 0.0 < high
    _, phase = draw_margins(result.poses, "", nyquist=False).axes[:2]
    low, high = phase.get_ylim()
    assert high - low <= 720.0
    assert low < -180.0 < high
    for line in phase.lines:
        if np.size(line.get_xdata()) > 100:
            assert np.abs(np.diff(np.asarray(line.get_ydata(), float))).max() < 180.0


def test_files_have_pictures(tmp_path: Path) -> None:
    """A table and three pictures, of unstable loops too; diagrams beside each other say so, and label one loop."""
    legends = [axes.get_legend() for axes in margins_of("unstable").plot().axes]
    assert sum("unstable" in text.get_text() for each in legends if each for text in each.get_texts()) == 3
    table, *pictures = write_margins(margins_of("unstable"), tmp_path)
    assert [path.name for path in (table, *pictures)] == ["margins.csv", "bode.png", "nyquist.png", "root-locus.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)
