"""Work-precision pictures can be read: labels lie apart, axes have plain numbers."""

from __future__ import annotations

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


@pytest.fixture
def crowded() -> Figure:
    """Two lines whose points are nearer to each other than their labels are long, one at the edge, and one far away."""
    figure = draw(6.6, 4.8)
    axes = figure.subplots()
    x = np.array([1.0, 1.3, 1.6, 2.0, 1000.0])
    for y in (x**-0.2, 1.05 * x**-0.3):
        axes.plot(x, y, "o-", label="a line")
        label_points(axes, np.column_stack([x, y]), [f"automatic {number}" for number in range(5)])
    axes.plot([30.0], [3.0], "o")
    label_points(axes, np.array([[30.0, 3.0]]), ["alone"])
    axes.set(xscale="log", yscale="log", xlim=(0.9, 1000.0))
    axes.legend()
    return figure


def labels(figure: Figure) -> dict[str, tuple[Annotation, np.ndarray]]:
    """Text and line of every visible label → it and its box [px], as the figure is drawn in the end."""
    figure.draw_without_rendering()
    texts = [each for each in figure.axes[0].texts if isinstance(each, Annotation) and each.get_visible()]
    return {f"{each.get_text()} of {each.xy[1]:.3f}": (each, each.get_window_extent().extents) for each in texts}


@pytest.mark.slow
def test_labels_lie_apart(crowded: Figure) -> None:
    """None covers another, a point or the legend, and all are within the diagram; as many as there is room for."""
    keep_apart(crowded)
    found = labels(crowded)
    axes = crowded.axes[0]
    legend = axes.get_legend()
    assert legend is not None
    boxes = [box for _, box in found.values()]
    for one, other in combinations([*boxes, legend.get_window_extent().extents], 2):
        assert max(other[0] - one[2], one[0] - other[2], other[1] - one[3], one[1] - other[3]) >= 0.0
    frame = axes.get_window_extent().extents
    points = np.concatenate([axes.transData.transform(np.column_stack(line.get_data())) for line in axes.lines])
    for box in boxes:
        assert (box[:2] >= frame[:2]).all()
        assert (box[2:] <= frame[2:]).all()
        assert not ((points > box[:2]) & (points < box[2:])).all(axis=1).any()
    assert 6 <= len(found) <= 11


@pytest.mark.parametrize("seed", range(2))
def test_labels_cover_neither_lines_nor_each_other(seed: int) -> None:
    """Of drawn methods whose lines cross; most ends of lines have their label, in a darker shade of the line's colour."""
    random = np.random.default_rng(seed)
    trials = tuple(
        WorkPrecisionTrial(
            "tools", f"method {line}", f"1e-{k:02}", 10.0 ** (-k * rate), 1e-3 * scale * 10.0 ** (0.2 * k)
        )
        for line, (rate, scale) in enumerate(zip(random.uniform(0.5, 1.2, 6), random.uniform(1.0, 8.0, 6), strict=True))
        for k in range(2, 9)
    )
    figure = draw(6.6, 4.8)
    axes = figure.subplots()
    draw_family(axes, WorkPrecisionStudy(load_scene("barnard2012-6kg"), 0.27, 2e-4, None, "", trials), "tools")
    keep_apart(figure)
    found = labels(figure)
    lines = [axes.transData.transform(np.column_stack(line.get_data())) for line in axes.lines]
    for text, box in found.values():
        frame = Bbox.from_extents(box[0] + 1.0, box[1] + 1.0, box[2] - 1.0, box[3] - 1.0)
        assert not any(MplPath(line).intersects_bbox(frame, filled=False) for line in lines), text
        assert any(np.allclose(0.75 * np.array(to_rgb(line.get_color())), text.get_color()) for line in axes.lines)
    for (_, one), (_, other) in combinations(found.values(), 2):
        assert max(other[0] - one[2], one[0] - other[2], other[1] - one[3], one[1] - other[3]) >= 0.0
    assert sum(text.get_gid() == "end" for text, _ in found.values()) >= 8


@pytest.mark.slow
def test_a_label_with_room_stays_where_it_is_looked_for(crowded: Figure) -> None:
    """To the right above its point."""
    keep_apart(crowded)
    alone, _ = labels(crowded)["alone of 3.000"]
    assert (alone.xyann, alone.get_ha(), alone.get_va()) == ((3.0, 3.0), "left", "bottom")


def test_axes_have_plain_numbers() -> None:
    """Times and real-time factors below one are written like those above."""
    trials = tuple(
        WorkPrecisionTrial("tools", "slow", label, error, time)
        for label, error, time in (("a", 1e-3, 9.0), ("b", 1e-5, 0.009))
    )
    figure = draw(6.6, 4.8)
    axes = figure.subplots()
    draw_family(axes, WorkPrecisionStudy(load_scene("barnard2012-6kg"), 0.27, 2e-4, None, "", trials), "tools")
    figure.draw_without_rendering()
    (factor,) = axes.child_axes
    for side, numbers in ((axes, {"10", "100", "1000"}), (factor, {"0.1", "1", "10"})):
        low, high = side.get_ylim()
        labels = side.yaxis.get_ticklabels(which="both")
        texts = {
            label.get_text() for label in labels if low <= label.get_position()[1] <= high
        }  # ticks beyond the axis aren't drawn
        assert numbers <= texts
        assert not any("e" in text for text in texts)
