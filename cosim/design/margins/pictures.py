"""Bode, Nyquist and root-locus diagrams of a sampled loop with its margins, as Matplotlib figures.

The loop with the smallest disk margin has a colour and its margins, all others are grey. A margin is the exact one of `LoopMargins`; it
is marked at the curve's own crossing. With one sample time both agree; a curve of a loop with several sample times is the part of its
response that keeps the frequency, from which exact margins differ by the part that doesn't.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import atan, degrees, inf, isfinite, isnan, log, log10, nan, pi
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator

from flexfmu.cosim.design.margins.linear_loop import ComplexArray, LinearLoop
from flexfmu.cosim.design.margins.margins import ALL, LoopMargins, PoseMargins
from flexfmu.cosim.reports.figure_style import GREY, INK, draw, style
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.trajectories.jets import RealArray

POINTS = 4000
"""Frequencies of a curve."""

GAINS = np.geomspace(0.05, 20.0, 160)
"""Factors of the torques of a root locus."""

WORST, OTHERS, DISK, CRITICAL = "#0b5fa5", "#c3cad1", "#f3c7cd", "#a3212f"
"""Colours of the worst loop, of all others, of the disk, and of -1."""

NYQUIST = 2.5
"""Magnitude up to which a page's Nyquist diagram shows a loop."""

FLOOR = -40.0
"""Magnitude [dB] at which the diagram ends."""

NEAR = log(1.15)
"""Logarithm of the ratio of a curve's margin and the exact one up to which a crossing is that of the margin."""

ABOVE: Mapping[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.3, "fontsize": 7.5}
"""Legends stand above their axes, where no curve is."""

REAL = 1e-9
"""Imaginary part relative to the magnitude below which a response is real."""

RATIOS = (0.1, 0.3, 0.5, 0.7)
"""Damping ratios of the lines of a root locus."""


@dataclass(frozen=True, eq=False)
class LoopCurve:
    """The open loop at a place, cut at one torque.

    Attributes:
        label: cut and place.
        margins: its margins.
        is_stable: whether the closed loop is stable.
        frequency: (N,) [Hz], ascending.
        response: (N,) complex gain of the loop, for negative feedback.
    """

    label: str
    margins: LoopMargins
    is_stable: bool
    frequency: RealArray
    response: ComplexArray

    @cached_property
    def decibels(self) -> RealArray:
        """Magnitude [dB], (N,)."""
        return np.asarray(20.0 * np.log10(np.maximum(np.abs(self.response), 1e-15)))

    @cached_property
    def phase(self) -> RealArray:
        """Phase [degrees], (N,), continuous; above -360 up to 0 degrees where the phase margin is, or a crossover."""
        found = np.degrees(np.unwrap(np.angle(self.response)))
        where = self.phase_crossover
        if isnan(where):
            where = float(np.append(self.gain_crossings, self.frequency[-1])[0])
        return np.asarray(found - 360.0 * np.ceil(np.interp(where, self.frequency, found) / 360.0))

    @cached_property
    def gain_crossings(self) -> RealArray:
        """Frequencies [Hz] at which the magnitude is 0 dB."""
        return self._crossings(self.decibels)

    @cached_property
    def gain_crossover(self) -> float:
        """Frequency [Hz] of the gain margin, where the phase is -180 degrees; NaN if the curve doesn't have it."""
        found = self._crossings(self.response.imag)
        # with one sample time the response is real at half the sampling frequency
        if abs(self.response[-1].imag) < REAL * abs(self.response[-1]):
            found = np.append(found, self.frequency[-1])
        found = found[np.interp(found, self.frequency, self.response.real) < 0.0]
        sizes = np.interp(np.log(found), np.log(self.frequency), self.decibels) * log(10.0) / 20.0
        return self._nearest(found, np.abs(sizes + log(self.margins.gain_margin)))

    @cached_property
    def phase_crossover(self) -> float:
        """Frequency [Hz] of the phase margin, where the magnitude is 0 dB; NaN if the curve doesn't have it."""
        found = self.gain_crossings
        angles = np.interp(found, self.frequency, np.unwrap(np.angle(-self.response)))
        angles = np.maximum(np.abs((angles + pi) % (2.0 * pi) - pi), 1e-12)
        return self._nearest(found, np.abs(np.log(angles / max(self.margins.phase_margin, 1e-12))))

    def _crossings(self, values: RealArray) -> RealArray:
        """Where values change their sign, on logarithmic frequencies."""
        k = np.flatnonzero(values[:-1] * values[1:] < 0.0)
        share, step = values[k] / (values[k] - values[k + 1]), np.log(self.frequency[k + 1] / self.frequency[k])
        return np.asarray(self.frequency[k] * np.exp(share * step))

    def _nearest(self, found: RealArray, misses: RealArray) -> float:
        """The frequency that misses a margin least; NaN if that is above `NEAR`, and for an unstable loop."""
        if not self.is_stable or misses.min(initial=inf) > NEAR:
            return nan
        return float(found[misses.argmin()])


@one_blas_thread()
def loop_curves(poses: Sequence[PoseMargins]) -> list[LoopCurve]:
    """The open loops at all poses and single cuts up to half the sampling frequency, the smallest disk margin first."""
    found, several = [], len({pose.carrier for pose in poses}) > 1
    for pose in poses:
        place = pose.place(several)
        for row, cut in zip(pose.loops, pose.open, strict=True):
            if row.channel == ALL:
                continue
            highest = pi * cut.size / cut.period
            frequency = np.geomspace(1e-5 * highest, highest, POINTS)
            response, label = cut.fundamental(frequency)[:, 0, 0], f"{row.channel.removesuffix('.torque')}, {place}"
            found.append(LoopCurve(label, row, pose.is_stable, frequency / (2.0 * pi), response))
    return sorted(found, key=lambda each: each.margins.disk_margin)


def draw_margins(poses: Sequence[PoseMargins], title: str, bode: bool = True, nyquist: bool = True) -> Figure:
    """Bode diagram of the open loops beside their Nyquist diagram about -1, or one of both.

    The former has magnitude [dB] and phase [degrees] over the frequency [Hz], with margins and crossovers; the latter the disk that
    the loop with the smallest disk margin doesn't enter.
    """
    with style():
        figure = draw(12.0 if bode and nyquist else 8.0 if bode else 6.4, 5.6 if bode and nyquist else 6.0)
        curves = loop_curves(poses)
        places = figure.add_gridspec(2, bode + nyquist, width_ratios=(1.3, 1.0)[: bode + nyquist])
        if bode:
            gain = figure.add_subplot(places[0, 0])
            _bode(gain, figure.add_subplot(places[1, 0], sharex=gain), curves)
        if nyquist:
            _nyquist(figure.add_subplot(places[:, -1]), curves)
        figure.suptitle(title, fontsize=10)
    return figure


def _bode(gain: Axes, phase: Axes, curves: Sequence[LoopCurve]) -> None:
    """Draw both axes of a Bode diagram."""
    worst, frequency, margins = curves[0], curves[0].frequency, curves[0].margins
    # from a decade below the first crossing to where all magnitudes stay below the floor
    crossings = [0.1 * float(each.gain_crossings[0]) for each in curves if each.gain_crossings.size]
    first = max(min(crossings, default=0.0), frequency[0])
    above = max(np.flatnonzero(each.decibels > FLOOR).max(initial=0) for each in curves)
    last = 1.1 * max(
        float(frequency[above]), 10.0 * first, *np.nan_to_num([worst.gain_crossover, worst.phase_crossover])
    )
    inside = (frequency >= first) & (frequency <= last)
    for curve in reversed(curves):
        how: Mapping[str, Any] = (
            {"color": WORST, "linewidth": 1.6, "zorder": 3.0}
            if curve is worst
            else {"color": OTHERS, "linewidth": 1.0, "zorder": 2.0}
        )
        # other curves by whole turns, so that they begin beside the worst one
        begin, other = (float(np.interp(first, each.frequency, each.phase)) for each in (curve, worst))
        gain.plot(curve.frequency, curve.decibels, **how)
        phase.plot(curve.frequency, curve.phase - 360.0 * round((begin - other) / 360.0), **how)
    # margins are lines between the worst curve and 0 dB or -180 degrees, crossovers dotted lines through both axes
    marking: Mapping[str, Any] = {"color": WORST, "linewidth": 2.4, "marker": "o", "markersize": 3.5, "zorder": 4.0}
    texts, lowest, decibels = ["unstable", "unstable"], FLOOR, inf
    if worst.is_stable:
        decibels, late = 20.0 * log10(margins.gain_margin), f"delay margin {1e3 * margins.delay_margin:.3g} ms"
        texts = [
            f"gain margin {decibels:.3g} dB (× {margins.gain_margin:.3g})",
            f"phase margin {degrees(margins.phase_margin):.3g}°, {late}",
        ]
        lowest = min(lowest, -decibels - 5.0) if isfinite(decibels) else lowest
    if not isnan(f := worst.gain_crossover):
        gain.plot([f, f], [0.0, -decibels], **marking)
    if not isnan(f := worst.phase_crossover):
        # to the line of -180 degrees that is next to it
        at, margin = float(np.interp(f, worst.frequency, worst.phase)), degrees(margins.phase_margin)
        line = -180.0 + 360.0 * round((at + 180.0) / 360.0)
        phase.plot([f, f], [line, line + (margin if at > line else -margin)], **marking)
    for axes, level, step, text in ((gain, 0.0, 20.0, texts[0]), (phase, -180.0, 90.0, texts[1])):
        for f in (worst.gain_crossover, worst.phase_crossover):
            axes.axvline(f, color=WORST, linewidth=0.9, linestyle=":", zorder=1.5)
        axes.plot([], [], color=WORST, label=f"{worst.label}: {text}")
        axes.axhline(level, color=INK, linewidth=0.8)
        axes.yaxis.set_major_locator(MultipleLocator(step))
    if len(curves) > 1:
        gain.plot([], [], color=OTHERS, label="other places and cuts")
    for axes in (gain, phase):
        axes.legend(**ABOVE)
    highest = min(max(float(np.max(each.decibels[inside])) for each in curves) + 5.0, 80.0)
    gain.set(xscale="log", xlim=(first, last), ylabel="magnitude [dB]", ylim=(lowest, highest))
    gain.tick_params(labelbottom=False)
    # multiples of 90 degrees about the phases, -180 degrees among them, two turns at most
    high = max(90.0 * np.ceil((worst.phase[inside].max() + 10.0) / 90.0), -90.0)
    low = max(min(90.0 * np.floor((worst.phase[inside].min() - 10.0) / 90.0), -270.0), high - 720.0)
    phase.set(ylabel="phase [°]", xlabel="frequency [Hz]", ylim=(low, high))
    phase.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=20))
    phase.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def disk_of(margin: float) -> tuple[float, float]:
    """The disk that a loop with a disk margin below 2 doesn't enter: its middle on the real axis, and its radius.

    Its diameter lies between the inverses of the gains (2 + margin) / (2 - margin) and (2 - margin) / (2 + margin).
    """
    left, right = -(2.0 + margin) / (2.0 - margin), -(2.0 - margin) / (2.0 + margin)
    return 0.5 * (left + right), 0.5 * (right - left)


def _nyquist(axes: Axes, curves: Sequence[LoopCurve]) -> None:
    """Draw the plane about -1."""
    worst, margin = curves[0], curves[0].margins.disk_margin
    shown = 1.8
    if 0.0 < margin < 2.0:
        middle, radius = disk_of(margin)
        shown = float(np.clip(1.3 * (radius - middle - 0.6), shown, 4.0))
        gains = f"gains × {(2 - margin) / (2 + margin):.3g} to {(2 + margin) / (2 - margin):.3g}"
        label = f"disk margin {margin:.3g}:\n{gains}, phases ± {degrees(2.0 * atan(0.5 * margin)):.3g}°"
        axes.add_patch(Circle((middle, 0.0), radius, color=DISK, linewidth=0.0, label=label, zorder=1.0))
    elif margin >= 2.0:
        # any gain, and phases up to a right angle: half the plane
        axes.add_patch(Rectangle((-1e3, -1e3), 1e3, 2e3, color=DISK, linewidth=0.0, label="disk margin 2", zorder=1.0))
    axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, color=GREY, linewidth=0.9, linestyle="--", zorder=1.5))
    for each in curves[1:]:
        axes.plot(each.response.real, each.response.imag, color=OTHERS, linewidth=1.0, zorder=2.0)
    z, label = worst.response, worst.label + ("" if worst.is_stable else ": unstable")
    axes.plot(z.real, z.imag, color=WORST, linewidth=1.6, label=label, zorder=3.0)
    axes.plot(z.real, -z.imag, color=WORST, linewidth=0.8, linestyle=(0, (4, 3)), label="negative frequencies")
    if len(curves) > 1:
        axes.plot([], [], color=OTHERS, label="other places and cuts")
    axes.plot(-1.0, 0.0, "+", color=CRITICAL, markersize=11, markeredgewidth=2.0, zorder=5.0)
    axes.set(xlim=(-0.6 - shown, -0.6 + shown), ylim=(-shown, shown), xlabel="real part", ylabel="imaginary part")
    axes.set_aspect("equal", adjustable="box")
    axes.legend(**ABOVE, ncols=2)


def draw_root_locus(poses: Sequence[PoseMargins], linear: Sequence[LinearLoop], title: str) -> Figure:
    """Eigenvalues over a period, in the z-plane, as all torques grow from a twentieth to twenty times their size."""
    with style():
        figure = draw(6.4, 6.6)
        axes = figure.add_subplot()
        axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, color=INK, linewidth=1.0))
        # lines of equal damping ratio: spirals into the origin
        turn = np.linspace(-pi, pi, 400)
        for ratio in RATIOS:
            z = np.exp(1j * turn - np.abs(turn) * ratio / np.sqrt(1.0 - ratio**2))
            axes.plot(z.real, z.imag, color=OTHERS, linewidth=0.8, zorder=1.0)
            axes.annotate(f"{ratio:g}", (z[260].real, z[260].imag), fontsize=7, color=GREY, ha="center", va="center")
        for k, (pose, loop) in enumerate(zip(poses, linear, strict=True)):
            factors = np.append(1.0, GAINS)[:, np.newaxis] * np.ones(len(loop.channels))
            now, *values = np.linalg.eigvals(loop.lifted.closed(factors))
            points, colour = np.concatenate(values), f"C{k % 10}"
            axes.plot(points.real, points.imag, ".", markersize=1.5, color=colour)
            axes.plot(now.real, now.imag, "x", color=colour, label=pose.place())
        axes.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3), xlabel="real part", ylabel="imaginary part")
        axes.set_aspect("equal", adjustable="box")
        axes.set_title(
            "torques × 0.05 to 20 (crosses: × 1), lines of equal damping ratio", fontsize=8.5, fontweight="normal"
        )
        axes.legend(fontsize=7.5, loc="lower right")
        figure.suptitle(title, fontsize=10)
    return figure
