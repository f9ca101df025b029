"""Work-precision pictures can be read: labels lie apart, axes have plain numbers."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.path import Path as MplPath
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

from flexfmu.cosim.reports.figure_style import draw
from flexfmu.cosim.studies.workprec.figures import draw_family, keep_apart, label_points
from flexfmu.cosim.studies.workprec.study import WorkPrecisionStudy
from flexfmu.cosim.studies.workprec.trial import WorkPrecisionTrial
from flexfmu.model.scene.file import load_scene


def drawn(trials: Iterable[WorkPrecisionTrial]) -> Figure:
    """The diagram of a family."""
    figure = draw(6.6, 4.8)
    study = WorkPrecisionStudy(load_scene("barnard2012-6kg"), 0.27, 2e-4, None, "", tuple(trials))
    draw_family(figure.subplots(), study, "tools")
    return figure


@pytest.mark.parametrize("seed", range(2))
def test_labels_cover_neither_lines_nor_each_other(seed: int) -> None:
    """Of drawn methods whose lines cross; all are within the diagram and clear of points and legend. Most ends of lines have their
    label, in a darker shade of the line's colour."""
    random = np.random.default_rng(seed)
    rates = zip(random.uniform(0.5, 1.2, 6), random.uniform(1.0, 8.0, 6), strict=True)
    figure = drawn(
        WorkPrecisionTrial(
            "tools", f"method {line}", f"1e-{k:02}", 10.0 ** (-k * rate), 1e-3 * scale * 10.0 ** (0.2 * k)
        )
        for line, (rate, scale) in enumerate(rates)
        for k in range(2, 9)
    )
    keep_apart(figure)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    texts = [each for each in axes.texts if isinstance(each, Annotation) and each.get_visible()]
    boxes = [each.get_window_extent().extents for each in texts]
    lines = [axes.transData.transform(np.column_stack(line.get_data())) for line in axes.lines]
    inside, points = axes.get_window_extent().extents, np.concatenate(lines)
    for text, box in zip(texts, boxes, strict=True):
        frame = Bbox.from_extents(box[0] + 1.0, box[1] + 1.0, box[2] - 1.0, box[3] - 1.0)
        assert not any(MplPath(line).intersects_bbox(frame, filled=False) for line in lines), text
        assert any(np.allclose(0.75 * np.array(to_rgb(line.get_color())), text.get_color()) for line in axes.lines)
        assert (box[:2] >= inside[:2]).all()
        assert (box[2:] <= inside[2:]).all()
        assert not ((points > box[:2]) & (points < box[2:])).all(axis=1).any()
    legend = axes.get_legend()
    others = [] if legend is None else [legend.get_window_extent().extents]
    for one, other in combinations([*boxes, *others], 2):
        assert max(other[0] - one[2], one[0] - other[2], other[1] - one[3], one[1] - other[3]) >= 0.0
    assert sum(text.get_gid() == "end" for text in texts) >= 8


def test_a_label_with_room_stays_where_it_is_looked_for() -> None:
    """To the right above its point."""
    figure = draw(6.6, 4.8)
    axes = figure.subplots()
    axes.plot([30.0], [3.0], "o")
    label_points(axes, np.array([[30.0, 3.0]]), ["alone"])
    axes.set(xscale="log", yscale="log", xlim=(0.9, 1000.0))
    keep_apart(figure)
    (alone,) = axes.texts
    assert isinstance(alone, Annotation)
    assert (alone.xyann, alone.get_ha(), alone.get_va()) == ((3.0, 3.0), "left", "bottom")


def test_axes_have_plain_numbers() -> None:
    """Times and real-time factors below one are written like those above; ticks beyond the axis aren't drawn."""
    figure = drawn(WorkPrecisionTrial("tools", "slow", *each) for each in (("a", 1e-3, 9.0), ("b", 1e-5, 0.009)))
    figure.draw_without_rendering()
    (axes,) = figure.axes
    (factor,) = axes.child_axes
    for side, numbers in ((axes, {"10", "100", "1000"}), (factor, {"0.1", "1", "10"})):
        low, high = side.get_ylim()
        labels = side.yaxis.get_ticklabels(which="both")
        texts = {label.get_text() for label in labels if low <= label.get_position()[1] <= high}
        assert numbers <= texts
        assert not any("e" in text for text in texts)
