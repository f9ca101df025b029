"""Bode, Nyquist and root-locus diagrams of a sampled loop with its margins, as Matplotlib figures.

The loops that are worst have colours and labels, all others are grey. A margin is the exact one of `LoopMargins`; it is marked at the
curve's own crossing. With one sample time both agree; a curve of a loop with several sample times is the part of its response
that keeps the frequency, from which exact margins differ by the part that doesn't.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import atan, degrees, inf, isfinite, isnan, log, log10, nan, pi
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator

from flexfmu.cosim.design.margins.linear_loop import ComplexArray, LiftedLoop, LinearLoop
from flexfmu.cosim.design.margins.margins import ALL, LoopMargins, PoseMargins
from flexfmu.cosim.reports.figure_style import GREY, INK, draw, style
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.trajectories.jets import RealArray

POINTS = 4000
"""Frequencies of a curve."""

GAINS = np.geomspace(0.05, 20.0, 160)
"""Factors of the torques of a root locus."""

COLOURS, OTHERS, DISK = ("#0b5fa5", "#c7394f", "#1f8a5f"), "#c3cad1", "#f3c7cd"
"""Of the worst loops, of all others, and of the disk."""

FLOOR, WIDER, DECADE = -40.0, 1.2, 10.0
"""Magnitude [dB] at which the diagram ends, and factors to the last and the first crossing that it shows at least."""

NEAR = log(1.15)
"""Logarithm of the ratio of a curve's margin and the exact one up to which a crossing is that of the margin."""

ABOVE: Mapping[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.3, "fontsize": 7.5}
"""Legends stand above their axes, where no curve is."""

REAL = 1e-9
"""Imaginary part relative to the magnitude below which a response is real."""

WORSE = 0.95
"""A loop whose margin is below this share of that of the one with the smallest disk margin has a colour of its own."""

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
        at = float(np.interp(where, self.frequency, found))
        return np.asarray(found - 360.0 * np.ceil(at / 360.0))

    @cached_property
    def gain_crossings(self) -> RealArray:
        """Frequencies [Hz] at which the magnitude is 0 dB."""
        return self._crossings(self.decibels)

    @cached_property
    def phase_crossings(self) -> RealArray:
        """Frequencies [Hz] at which the phase is -180 degrees, turns aside."""
        found = self._crossings(self.response.imag)
        # with one sample time the response is real at half the sampling frequency
        if abs(self.response[-1].imag) < REAL * abs(self.response[-1]):
            found = np.append(found, self.frequency[-1])
        return found[np.interp(found, self.frequency, self.response.real) < 0.0]

    def _crossings(self, values: RealArray) -> RealArray:
        """Where values change their sign, on logarithmic frequencies."""
        k = np.flatnonzero(values[:-1] * values[1:] < 0.0)
        share, step = values[k] / (values[k] - values[k + 1]), np.log(self.frequency[k + 1] / self.frequency[k])
        return np.asarray(self.frequency[k] * np.exp(share * step))

    def decibels_at(self, frequency: float) -> float:
        """Magnitude [dB] at a frequency [Hz]."""
        return float(np.interp(log(frequency), np.log(self.frequency), self.decibels))

    @cached_property
    def gain_crossover(self) -> float:
        """Frequency [Hz] of the gain margin, where the phase is -180 degrees; NaN if the curve doesn't have it."""
        wanted = (
            -20.0 * log10(self.margins.gain_margin) if self.is_stable and isfinite(self.margins.gain_margin) else nan
        )
        misses = {f: abs(self.decibels_at(f) - wanted) for f in self.phase_crossings.tolist()}
        return _nearest(misses, 20.0 / log(10.0) * NEAR)

    @cached_property
    def phase_crossover(self) -> float:
        """Frequency [Hz] of the phase margin, where the magnitude is 0 dB; NaN if the curve doesn't have it."""
        if not self.is_stable:
            return nan
        angles = np.unwrap(np.angle(-self.response))
        misses = {}
        for f in self.gain_crossings.tolist():
            angle = abs((float(np.interp(f, self.frequency, angles)) + pi) % (2.0 * pi) - pi)
            misses[f] = abs(log(max(angle, 1e-12) / self.margins.phase_margin))
        return _nearest(misses, NEAR)


def _nearest(misses: Mapping[float, float], most: float) -> float:
    """The key with the smallest value, NaN if that is above a limit."""
    found = min(misses, key=misses.__getitem__, default=nan)
    return found if misses.get(found, inf) <= most else nan


@one_blas_thread()
def loop_curves(poses: Sequence[PoseMargins]) -> list[LoopCurve]:
    """The open loops at all poses and single cuts, those with the smallest disk margin first."""
    found, several = [], len({pose.payload for pose in poses}) > 1
    for pose in poses:
        for row, cut in zip(pose.loops, pose.open, strict=True):
            if row.channel == ALL:
                continue
            place = f"path {pose.s:.2f}" + (f", {pose.payload:.4g} kg" if several else "")
            label = f"{row.channel.removesuffix('.torque')}, {place}"
            found.append(LoopCurve(label, row, pose.is_stable, *_response(cut)))
    return sorted(found, key=lambda each: each.margins.disk_margin)


def _response(cut: LiftedLoop) -> tuple[RealArray, ComplexArray]:
    """Frequencies [Hz] up to half the sampling frequency, and the response there."""
    highest = pi * cut.size / cut.period
    frequency = np.geomspace(1e-5 * highest, highest, POINTS)
    return frequency / (2.0 * pi), cut.fundamental(frequency)[:, 0, 0]


def worst_curves(curves: Sequence[LoopCurve]) -> list[LoopCurve]:
    """The loop with the smallest disk margin, and those that have the smallest gain or phase margin, if these are noticeably smaller."""
    worst = [curves[0]]
    measures: tuple[Callable[[LoopMargins], float], ...] = (lambda m: m.gain_margin, lambda m: m.phase_margin)
    for measure in measures:
        least = min(curves, key=lambda each: measure(each.margins))
        if measure(least.margins) < WORSE * measure(curves[0].margins) and least not in worst:
            worst.append(least)
    return worst


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
    worst = worst_curves(curves)
    first, last = _range(curves, worst)
    lowest = FLOOR
    for curve in reversed(curves):
        place = worst.index(curve) if curve in worst else None
        colour = OTHERS if place is None else COLOURS[place]
        about: Mapping[str, Any] = {
            "color": colour,
            "linewidth": 1.0 if place is None else 1.6,
            "zorder": 2.0 if place is None else 3.0,
        }
        # other curves by whole turns, so that they begin beside the worst one
        begin = (float(np.interp(first, each.frequency, each.phase)) for each in (curve, worst[0]))
        turns = 0.0 if curve is worst[0] else -360.0 * round((next(begin) - next(begin)) / 360.0)
        gain.plot(curve.frequency, curve.decibels, **about)
        phase.plot(curve.frequency, curve.phase + turns, **about)
        if place is not None:
            _mark(gain, phase, curve, colour, turns)
            if isfinite(curve.margins.gain_margin):
                lowest = min(lowest, -20.0 * log10(curve.margins.gain_margin) - 5.0)
    # labels of the worst ones, and of the others as one
    for axes, text in ((gain, _gain_text), (phase, _phase_text)):
        handles = [axes.plot([], [], color=COLOURS[k])[0] for k in range(len(worst))]
        labels = [f"{each.label}: {text(each)}" for each in worst]
        if len(curves) > len(worst) and axes is gain:
            handles.append(axes.plot([], [], color=OTHERS)[0])
            labels.append("other places and cuts")
        axes.legend(handles, labels, **ABOVE)
    inside = [each.decibels[(each.frequency >= first) & (each.frequency <= last)] for each in curves]
    gain.set(xscale="log", xlim=(first, last), ylabel="magnitude [dB]")
    gain.set_ylim(lowest, min(max(float(np.max(each)) for each in inside) + 5.0, 80.0))
    gain.tick_params(labelbottom=False)
    gain.yaxis.set_major_locator(MultipleLocator(20.0))
    gain.axhline(0.0, color=INK, linewidth=0.8)
    phase.axhline(-180.0, color=INK, linewidth=0.8)
    phase.yaxis.set_major_locator(MultipleLocator(90.0))
    low, high = phase_limits(worst, first, last)
    phase.set(ylabel="phase [°]", xlabel="frequency [Hz]", ylim=(low, high))
    phase.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=20))
    phase.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def phase_limits(worst: Sequence[LoopCurve], first: float, last: float) -> tuple[float, float]:
    """Multiples of 90 degrees about the phases between two frequencies, -180 degrees among them, two turns at most."""
    found = [each.phase[(each.frequency >= first) & (each.frequency <= last)] for each in worst]
    low, high = (float(pick([pick(each) for each in found])) for pick in (np.min, np.max))
    high = max(90.0 * np.ceil((high + 10.0) / 90.0), -90.0)
    return max(min(90.0 * np.floor((low - 10.0) / 90.0), -270.0), high - 720.0), high


def _range(curves: Sequence[LoopCurve], worst: Sequence[LoopCurve]) -> tuple[float, float]:
    """The frequencies [Hz] of the diagram: from a decade below the first crossing to where the magnitude stays below `FLOOR`."""
    frequency = curves[0].frequency
    crossings = np.concatenate([each.gain_crossings for each in curves])
    marked = [f for each in worst for f in (each.gain_crossover, each.phase_crossover) if not isnan(f)]
    first = max(float(crossings.min()) / DECADE, frequency[0]) if crossings.size else frequency[0]
    above = max(np.flatnonzero(each.decibels > FLOOR).max(initial=0) for each in curves)
    last = max(float(frequency[above]), *(WIDER * f for f in [first * DECADE, *marked]))
    return first, min(last, 1.1 * float(frequency[-1]))


def _mark(gain: Axes, phase: Axes, curve: LoopCurve, colour: str, turns: float) -> None:
    """Draw margins as lines between a curve and 0 dB or -180 degrees, and crossovers as dotted lines through both axes."""
    marking: Mapping[str, Any] = {
        "color": colour,
        "linewidth": 2.4,
        "solid_capstyle": "butt",
        "marker": "o",
        "markersize": 3.5,
        "zorder": 4.0,
    }
    if not isnan(f := curve.gain_crossover):
        gain.plot([f, f], [0.0, -20.0 * log10(curve.margins.gain_margin)], **marking)
    if not isnan(f := curve.phase_crossover):
        # to the line of -180 degrees that is next to it
        at = float(np.interp(f, curve.frequency, curve.phase)) + turns
        line = -180.0 + 360.0 * round((at + 180.0) / 360.0)
        margin = degrees(curve.margins.phase_margin)
        phase.plot([f, f], [line, line + (margin if at > line else -margin)], **marking)
    for f in (curve.gain_crossover, curve.phase_crossover):
        for axes in (gain, phase) if not isnan(f) else ():
            axes.axvline(f, color=colour, linewidth=0.9, linestyle=":", zorder=1.5)


def _gain_text(curve: LoopCurve) -> str:
    """The gain margin in words, with where it is."""
    if not curve.is_stable:
        return "unstable"
    margin = curve.margins.gain_margin
    if not isfinite(margin):
        return "gain margin ∞"
    where = f" at {curve.gain_crossover:.3g} Hz" if not isnan(curve.gain_crossover) else ""
    return f"gain margin {20.0 * log10(margin):.3g} dB (× {margin:.3g}){where}"


def _phase_text(curve: LoopCurve) -> str:
    """The phase and delay margins in words, with where the former is."""
    if not curve.is_stable:
        return "unstable"
    where = f" at {curve.phase_crossover:.3g} Hz" if not isnan(curve.phase_crossover) else ""
    delay = curve.margins.delay_margin
    late = f"{1e3 * delay:.3g} ms" if isfinite(delay) else "∞"
    return f"phase margin {degrees(curve.margins.phase_margin):.3g}°{where}, delay margin {late}"


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
        turn = degrees(2.0 * atan(0.5 * margin))
        label = f"disk margin {margin:.3g}:\ngains × {(2 - margin) / (2 + margin):.3g} to {(2 + margin) / (2 - margin):.3g}, phases ± {turn:.3g}°"
        axes.add_patch(Circle((middle, 0.0), radius, color=DISK, linewidth=0.0, label=label, zorder=1.0))
    elif margin >= 2.0:
        # any gain, and phases up to a right angle: half the plane
        axes.add_patch(Rectangle((-1e3, -1e3), 1e3, 2e3, color=DISK, linewidth=0.0, label="disk margin 2", zorder=1.0))
    circle = Circle((0.0, 0.0), 1.0, fill=False, color=GREY, linewidth=0.9, linestyle="--", zorder=1.5)
    axes.add_patch(circle)
    for curve in reversed(curves):
        colour, width = (COLOURS[0], 1.6) if curve is worst else (OTHERS, 1.0)
        label = "" if curve is not worst else curve.label + ("" if curve.is_stable else ": unstable")
        z = curve.response
        axes.plot(z.real, z.imag, color=colour, linewidth=width, label=label, zorder=3.0 if curve is worst else 2.0)
        if curve is worst:
            axes.plot(z.real, -z.imag, color=colour, linewidth=0.8, linestyle=(0, (4, 3)), label="negative frequencies")
    if len(curves) > 1:
        axes.plot([], [], color=OTHERS, label="other places and cuts")
    axes.plot(-1.0, 0.0, "+", color="#a3212f", markersize=11, markeredgewidth=2.0, zorder=5.0)
    axes.annotate(
        "-1".replace("-", "−"),
        (-1.0, 0.0),
        (-4, 5),
        textcoords="offset points",
        ha="right",
        fontsize=9,
        color="#a3212f",
    )
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
        turn = np.linspace(0.0, pi, 200)
        for ratio in RATIOS:
            z = np.exp(turn * (1j - ratio / np.sqrt(1.0 - ratio**2)))
            for way in (z, z.conj()):
                axes.plot(way.real, way.imag, color=OTHERS, linewidth=0.8, zorder=1.0)
            axes.annotate(f"{ratio:g}", (z[60].real, z[60].imag), fontsize=7, color=GREY, ha="center", va="center")
        for k, (pose, loop) in enumerate(zip(poses, linear, strict=True)):
            factors = np.append(1.0, GAINS)[:, np.newaxis] * np.ones(len(loop.channels))
            now, *values = np.linalg.eigvals(loop.lifted.closed(factors))
            points, colour = np.concatenate(values), f"C{k % 10}"
            axes.plot(points.real, points.imag, ".", markersize=1.5, color=colour)
            axes.plot(now.real, now.imag, "x", color=colour, label=f"path {pose.s:.2f}")
        axes.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3), xlabel="real part", ylabel="imaginary part")
        axes.set_aspect("equal", adjustable="box")
        axes.set_title(
            "torques × 0.05 to 20 (crosses: × 1), lines of equal damping ratio", fontsize=8.5, fontweight="normal"
        )
        axes.legend(fontsize=7.5, loc="lower right")
        figure.suptitle(title, fontsize=10)
    return figure
