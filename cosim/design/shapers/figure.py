"""Draws a shaper study: residual vibration over the true frequency in closed form, and over the simulated payload error."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FormatStrFormatter

from flexfmu.cosim.design.shapers.examination import ShaperStudy
from flexfmu.cosim.design.shapers.study import UNSHAPED_NAME
from flexfmu.cosim.reports.figure_style import GREY, INK, PALE, draw, save

POINTS = 500
"""Points of a sensitivity curve."""

LOWEST_SHOWN = 1e-3
"""Residual vibration below which closed-form curves aren't drawn; the axis is logarithmic."""

STYLES = {"joints": "-", "path": (0, (3, 2)), "-": "-"}
"""Application of a shaper → line style."""

THICK, THIN, DASHED = 2.6, 1.1, (0, (4, 3))
"""Widths of lines, that of the recommended shaper first; lines of what isn't a shaper."""


def draw_sensitivity(study: ShaperStudy) -> Figure:
    """Draw both panels; the recommended shaper has the thickest line."""
    # a colour for each shaper
    figure = draw(10.0, 4.6)
    names = list(dict.fromkeys(r.candidate.name for r in study.results if r.candidate.name != UNSHAPED_NAME))
    palette = colormaps["turbo"](np.linspace(0.05, 0.95, max(len(names), 1)))
    colours: Mapping[str, Any] = {**dict(zip(names, palette, strict=True)), UNSHAPED_NAME: INK}
    # panels and a common legend
    left, right = figure.subplots(1, 2)
    _closed_form(left, study, colours)
    _simulated(right, study, colours)
    for axes in (left, right):
        # 0.1, 1, 10 instead of powers of ten
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    styles = [
        Line2D([], [], color=INK, linewidth=THICK, label=UNSHAPED_NAME),
        Line2D([], [], color=GREY, linestyle=STYLES["joints"], label="joints shaped"),
        Line2D([], [], color=GREY, linestyle=STYLES["path"], label="motion along path shaped"),
    ]
    handles, _ = left.get_legend_handles_labels()
    figure.legend(handles=[*handles, *styles], loc="outside lower center", ncols=6, fontsize=8)
    return figure


def save_sensitivity(study: ShaperStudy, folder: Path) -> None:
    """Write ``sensitivity.png`` and ``sensitivity.svg``.

    Raises:
        ResultsError: the folder can't be written.
    """
    save(partial(draw_sensitivity, study), folder / "sensitivity")


def _closed_form(axes: Axes, study: ShaperStudy, colours: Mapping[str, Any]) -> None:
    """Draw the residual vibration of each sequence over the natural frequency, with the payload band and the modes."""
    # the payload band, and all modes
    design, mode = study.design, study.design.modes[0]
    frequency = np.linspace(0.5 * design.band[0], 1.3 * design.band[1], POINTS)
    axes.axvspan(*design.first_band, color=PALE, label="payload band of mode 1")
    for other in design.modes:
        axes.axvline(other.frequency, color=GREY, linewidth=0.8, linestyle=DASHED)
    # a line for each sequence, with gaps below the axis
    for candidate in {result.candidate.name: result.candidate for result in study.results}.values():
        if candidate.name == UNSHAPED_NAME:
            continue
        residual = candidate.sequence.residual(frequency, mode.ratio)
        residual[residual < LOWEST_SHOWN] = np.nan
        width = THICK if candidate.name == study.recommendation.result.candidate.name else THIN
        axes.plot(frequency, 100.0 * residual, color=colours[candidate.name], linewidth=width, label=candidate.name)
    axes.axhline(5.0, color=GREY, linewidth=0.8, linestyle=":")
    axes.set(ylim=(100.0 * LOWEST_SHOWN, 150.0), xlim=(frequency[0], frequency[-1]), xlabel="natural frequency [Hz]")
    axes.set(ylabel="residual vibration [% of unshaped impulse]", title="One oscillator, closed form")


def _simulated(axes: Axes, study: ShaperStudy, colours: Mapping[str, Any]) -> None:
    """Draw the residual vibration of the co-simulated robot over the payload error, a line for each motion."""
    for result in study.results:
        candidate = result.candidate
        errors = [100.0 * trial.payload_error for trial in result.trials]
        residuals = [1e6 * max(trial.residual, 1e-12) for trial in result.trials]
        width = THICK if result is study.recommendation.result or candidate.name == UNSHAPED_NAME else THIN
        (line,) = axes.plot(errors, residuals, color=colours[candidate.name], linewidth=width)
        line.set(linestyle=STYLES[candidate.application], marker="o", markersize=0.5 + width)
    band = 1e6 * study.scene.cosimulation.settling_band
    axes.axhline(band, color=GREY, linewidth=0.9, linestyle=DASHED, label="settling band")
    axes.set(xlabel="payload error [%]", ylabel="residual vibration [µm]", title="Robot, co-simulated")
