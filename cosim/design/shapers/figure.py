"""Draws a shaper study: residual vibration over the true frequency in closed form, over the simulated payload error,
and over time without and with the recommended shaper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FormatStrFormatter

from flexfmu.cosim.design.shapers.alternatives import DesignModes
from flexfmu.cosim.design.shapers.study import UNSHAPED_NAME, CandidateResult
from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.reports.figure_style import GREY, INK, PALE, draw, save, style

POINTS = 500
"""Points of a sensitivity curve."""

LOWEST_SHOWN = 1e-3
"""Residual vibration below which closed-form curves aren't drawn; the axis is logarithmic."""

STYLES = {"joints": "-", "path": (0, (3, 2)), "-": "-"}
"""Application of a shaper → line style."""


Vibrations = Mapping[str, tuple[RealArray, RealArray]]
"""Label of a motion → times after its end [s] and distances from where the robot comes to rest [m]."""


def draw_sensitivity(
    results: Sequence[CandidateResult],
    design: DesignModes,
    recommended: CandidateResult,
    band: float,
    vibrations: Vibrations,
) -> Figure:
    """Draw the three panels; the recommended shaper has the thickest line.

    Args:
        results: all results, the unshaped motion included.
        design: modes that the shapers were designed for.
        recommended: the recommended result.
        band: settling band [m].
        vibrations: of the unshaped motion and the recommended one, with the scene's own payload.
    """
    # a colour for each shaper
    figure = draw(14.5, 4.6)
    names = list(dict.fromkeys(r.candidate.name for r in results if r.candidate.name != UNSHAPED_NAME))
    palette = colormaps["turbo"](np.linspace(0.05, 0.95, max(len(names), 1)))
    colours: Mapping[str, Any] = {**dict(zip(names, palette, strict=True)), UNSHAPED_NAME: INK}
    # panels and a common legend
    left, right, last = figure.subplots(1, 3)
    _closed_form(left, results, design, colours, recommended)
    _simulated(right, results, colours, recommended, band)
    _before_and_after(last, vibrations, recommended, band)
    handles, _ = left.get_legend_handles_labels()
    figure.legend(handles=[*handles, *_line_styles()], loc="outside lower center", ncols=6, fontsize=8)
    return figure


def _plain_numbers(axes: Axes) -> None:
    """Label the axis with 0.1, 1, 10 instead of powers of ten."""
    axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))


def save_sensitivity(
    results: Sequence[CandidateResult],
    design: DesignModes,
    recommended: CandidateResult,
    band: float,
    vibrations: Vibrations,
    folder: Path,
) -> None:
    """Write ``sensitivity.png`` and ``sensitivity.svg``.

    Raises:
        ResultsError: the folder can't be written.
    """
    stem = folder / "sensitivity"
    try:
        with style():
            save(draw_sensitivity(results, design, recommended, band, vibrations), stem)
    except OSError as error:
        raise ResultsError(
            f"can't write {stem}: {error.strerror or error}; choose another folder or free some space"
        ) from error


def _closed_form(
    axes: Axes,
    results: Sequence[CandidateResult],
    design: DesignModes,
    colours: Mapping[str, Any],
    recommended: CandidateResult,
) -> None:
    """Draw the residual vibration of each sequence over the natural frequency, with the payload band and the modes."""
    # the payload band, and all modes
    mode = design.modes[0]
    frequency = np.linspace(0.5 * design.band[0], 1.3 * design.band[1], POINTS)
    axes.axvspan(*design.first_band, color=PALE, label="payload band of mode 1")
    for other in design.modes:
        axes.axvline(other.frequency, color=GREY, linewidth=0.8, linestyle=(0, (4, 3)))
    # a line for each sequence, with gaps below the axis
    for candidate in {result.candidate.name: result.candidate for result in results}.values():
        if candidate.name == UNSHAPED_NAME:
            continue
        residual = candidate.sequence.residual(frequency, mode.ratio)
        residual[residual < LOWEST_SHOWN] = np.nan
        width = 2.6 if candidate.name == recommended.candidate.name else 1.1
        axes.plot(frequency, 100.0 * residual, color=colours[candidate.name], linewidth=width, label=candidate.name)
    axes.axhline(5.0, color=GREY, linewidth=0.8, linestyle=":")
    axes.set(
        yscale="log",
        ylim=(100.0 * LOWEST_SHOWN, 150.0),
        xlim=(frequency[0], frequency[-1]),
        xlabel="natural frequency [Hz]",
        ylabel="residual vibration [% of unshaped impulse]",
        title="One oscillator, closed form",
    )
    _plain_numbers(axes)


def _simulated(
    axes: Axes,
    results: Sequence[CandidateResult],
    colours: Mapping[str, Any],
    recommended: CandidateResult,
    band: float,
) -> None:
    """Draw the residual vibration of the co-simulated robot over the payload error."""
    # a line for each motion
    for result in results:
        candidate = result.candidate
        errors = [100.0 * trial.payload_error for trial in result.trials]
        residuals = [1e6 * max(trial.residual, 1e-12) for trial in result.trials]
        width = 2.6 if result is recommended or candidate.name == UNSHAPED_NAME else 1.1
        line = STYLES[candidate.application]
        axes.plot(
            errors,
            residuals,
            color=colours[candidate.name],
            linewidth=width,
            linestyle=line,
            marker="o",
            markersize=0.5 + width,
        )
    # settling band and axes
    axes.axhline(1e6 * band, color=GREY, linewidth=0.9, linestyle=(0, (4, 3)), label="settling band")
    axes.set(
        yscale="log",
        xlabel="payload error [%]",
        ylabel="residual vibration [µm]",
        title="Robot, co-simulated",
    )
    _plain_numbers(axes)


def _before_and_after(axes: Axes, vibrations: Vibrations, recommended: CandidateResult, band: float) -> None:
    """Draw the vibration after the motion's end, without and with the recommended shaper."""
    for label, (time, distance) in vibrations.items():
        is_before = label == UNSHAPED_NAME
        # a logarithmic axis has no zero
        shown = 1e6 * np.maximum(distance, 1e-10)
        axes.plot(1e3 * time, shown, color=GREY if is_before else INK, linewidth=1.2, label=label)
    axes.axhline(1e6 * band, color=GREY, linewidth=0.9, linestyle=(0, (4, 3)))
    axes.set(
        yscale="log",
        xlabel="time after the motion's end [ms]",
        ylabel="distance from rest [µm]",
        title=f"Before and after, {recommended.candidate.label}",
    )
    axes.legend(loc="upper right", fontsize=8)
    _plain_numbers(axes)


def _line_styles() -> list[Line2D]:
    """Return the legend of line styles in the panel of simulations."""
    return [
        Line2D([], [], color=INK, linewidth=2.6, label=UNSHAPED_NAME),
        Line2D([], [], color=GREY, linestyle=STYLES["joints"], label="joints shaped"),
        Line2D([], [], color=GREY, linestyle=STYLES["path"], label="motion along path shaped"),
    ]
