"""Charts of the report: ticks where matplotlib has them, curves through their points, axes to scale."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from flexfmu.cosim.reports.chart import Axis, Curve, Marker, Panel, draw_chart
from flexfmu.cosim.reports.svg import path


@pytest.mark.parametrize("seed", range(40))
def test_ticks_are_matplotlib_s(seed: int) -> None:
    """The same values at any range and length, with the same texts."""
    rng = np.random.default_rng(seed)
    low = rng.uniform(-1.0, 1.0) * 10.0 ** rng.uniform(-2.0, 4.0)
    high, length, room = low + 10.0 ** rng.uniform(-1.0, 4.0), rng.uniform(60.0, 330.0), rng.choice([18.0, 27.0])
    axis = Axis(low, high, 0.0, length, room)
    intervals = int(np.clip(length // room, 1, 9))
    expected = MaxNLocator(intervals, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
    expected = expected[(expected >= low) & (expected <= high)]
    np.testing.assert_allclose(axis.ticks, expected, rtol=1e-12, atol=1e-12 * abs(high - low))
    formatter = ScalarFormatter(useOffset=False)
    formatter.create_dummy_axis()
    formatter.axis.set_view_interval(low, high)
    assert axis.labels == formatter.format_ticks(expected)


def test_small_values_are_powers_of_ten() -> None:
    """A rigid robot's errors are rounding: the labels say so, instead of a row of zeros."""
    labels = Axis(0.0, 4e-12, 100.0, 0.0, 18.0).labels
    assert labels[0] == "0"
    assert labels[1] == "1e−12"


def test_a_path_has_every_turn_and_breaks_where_a_value_is_missing() -> None:
    """Points on a straight line between their neighbours are left out, peaks and isolated stretches are not."""
    x = np.arange(9.0)
    y = np.array([0.0, 1.0, 2.0, 1.0, 0.0, np.nan, 5.0, np.inf, 7.0])
    assert path(x, y) == "M0.0 0.0 2.0 2.0 4.0 0.0M6.0 5.0M8.0 7.0"
    assert path(np.zeros(0), np.zeros(0)) == ""
    back = path(np.array([0.0, 2.0, 1.0]), np.zeros(3))
    assert back == "M0.0 0.0 2.0 0.0 1.0 0.0"


def test_a_path_follows_its_points() -> None:
    """Dense or not, no point is further from the path than the rounding of its coordinates."""
    x = np.linspace(0.0, 330.0, 4001)
    y = 60.0 + 50.0 * np.sin(x / 3.0) * np.exp(-x / 200.0)
    points = np.array([float(each) for each in re.findall(r"[\d.]+", path(x, y))]).reshape(-1, 2)
    assert len(points) < len(x)
    error = np.abs(np.interp(x, points[:, 0], points[:, 1]) - y)
    assert np.all(error < 0.06 * (1.0 + np.abs(np.gradient(y, x))))
    assert points[:, 1].max() == pytest.approx(y.max(), abs=0.051)


@pytest.mark.parametrize("value", [0.0, 3.0, -2e-9])
def test_a_constant_has_an_axis(value: float) -> None:
    """A curve without extent, and none at all, leave finite coordinates."""
    time = np.linspace(0.0, 1.0, 5)
    for curves in ([Curve(time, np.full(5, value))], [], [Curve(time, np.full(5, np.nan))]):
        text = draw_chart("k", "t", (300.0, 200.0), "time [s]", [Panel(label="x", curves=curves)])
        ElementTree.fromstring(text)
        assert "nan" not in text
        assert "inf" not in text


@pytest.mark.parametrize("extent", [(4.0, 1.0), (1.0, 4.0)])
def test_one_scale_for_both_axes(extent: tuple[float, float]) -> None:
    """A square stays one, whether the width or the height of the chart limits it."""
    curve = Curve(np.array([0.0, extent[0]]), np.array([0.0, extent[1]]))
    markers = [Marker(x, y, size=2.0) for x, y in ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5))]
    text = draw_chart(
        "k", "t", (300.0, 200.0), "x", [Panel(label="y", curves=[curve], markers=markers, is_to_scale=True)]
    )
    (x0, y0), (x1, _), (_, y2) = (
        map(float, found) for found in re.findall(r'class="at" .*?translate\((\S+) (\S+)\)', text)
    )
    assert x1 - x0 == pytest.approx(y0 - y2, abs=0.02)
    assert x1 - x0 > 10.0
