"""Draws a shaper study: residual vibration over the true frequency in closed form, and over the simulated payload error."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from flexfmu.cosim.design.shapers.examination import ShaperStudy
from flexfmu.cosim.design.shapers.study import UNSHAPED_NAME
from flexfmu.cosim.reports.chart import GREY, INK, Curve, Panel
from flexfmu.cosim.reports.figure_style import figure_of, save
from flexfmu.cosim.reports.page import Plot

POINTS = 500
"""Points of a sensitivity curve."""

SHOWN = np.array([0.1, 150.0])
"""Residual vibrations between which closed-form curves are drawn [% of an unshaped impulse]."""

LINES: Mapping[str, tuple[str, tuple[float, ...]]] = {
    "joints": ("joints shaped", ()),
    "path": ("motion along path shaped", (3.0, 2.0)),
}
"""Application of a shaper → its name, and dashes of lines."""

THICK, THIN = 2.6, 1.1
"""Widths of lines, that of the recommended shaper first."""


def draw_sensitivity(study: ShaperStudy) -> Figure:
    """Draw both plots; the recommended shaper has the thickest line."""
    # a colour for each shaper
    names = list(dict.fromkeys(r.candidate.name for r in study.results if r.candidate.name != UNSHAPED_NAME))
    palette = map(to_hex, colormaps["turbo"](np.linspace(0.05, 0.95, max(len(names), 1))))
    colours = {**dict(zip(names, palette, strict=True)), UNSHAPED_NAME: INK}
    return figure_of([_closed_form(study, colours), _simulated(study, colours)], columns=2)


def save_sensitivity(study: ShaperStudy, folder: Path) -> None:
    """Write ``sensitivity.png`` and ``sensitivity.svg``.

    Raises:
        ResultsError: the folder can't be written.
    """
    save(partial(draw_sensitivity, study), folder / "sensitivity")


def _closed_form(study: ShaperStudy, colours: Mapping[str, str]) -> Plot:
    """The residual vibration of each sequence over the natural frequency, with the payload band and the modes."""
    design, mode = study.design, study.design.modes[0]
    frequency, (low, high) = np.linspace(0.5 * design.band[0], 1.3 * design.band[1], POINTS), design.first_band
    band = np.array([low, high, high, low]), np.repeat(SHOWN, 2)
    curves = [Curve(*band, "payload band of mode 1", GREY, 0.0, fill=0.2)]
    # a line for each sequence, with gaps beyond the axis
    for candidate in {result.candidate.name: result.candidate for result in study.results}.values():
        if candidate.name != UNSHAPED_NAME:
            residual = 100.0 * candidate.sequence.residual(frequency, mode.ratio)
            residual[(residual < SHOWN[0]) | (residual > SHOWN[1])] = np.nan
            width = THICK if candidate.name == study.recommendation.result.candidate.name else THIN
            curves.append(Curve(frequency, residual, candidate.name, colours[candidate.name], width))
    panel = Panel(
        "residual vibration [% of unshaped impulse]", curves, limits=(float(frequency[0]), float(frequency[-1])), logarithmic="y",
        level=5.0, marks=[(other.frequency, "") for other in design.modes],
    )  # fmt: skip
    return Plot("closed-form", "One oscillator, closed form", "", (panel,), "natural frequency [Hz]", 300.0)


def _simulated(study: ShaperStudy, colours: Mapping[str, str]) -> Plot:
    """The residual vibration of the co-simulated robot over the payload error, a line for each motion."""
    curves = [
        Curve(np.array([np.nan]), np.array([np.nan]), text, GREY, dashes=dashes) for text, dashes in LINES.values()
    ]
    for result in study.results:
        name, (_, dashes) = result.candidate.name, LINES.get(result.candidate.application, ("", ()))
        errors = np.array([100.0 * trial.payload_error for trial in result.trials])
        residuals = np.array([1e6 * max(trial.residual, 1e-12) for trial in result.trials])
        width = THICK if result is study.recommendation.result or name == UNSHAPED_NAME else THIN
        label = name if name == UNSHAPED_NAME else ""
        curves.append(Curve(errors, residuals, label, colours[name], width, dot="disc", dashes=dashes))
    level = 1e6 * study.scene.cosimulation.settling_band
    panel = Panel("residual vibration [µm]", curves, level=level, logarithmic="y", is_function=False)
    return Plot("simulated", "Robot, co-simulated; dashed: settling band", "", (panel,), "payload error [%]", 300.0)
