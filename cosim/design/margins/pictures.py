"""Bode, Nyquist and root-locus diagrams of a sampled loop with its margins, for pages and files.

The loop with the smallest disk margin has a colour and its margins, all others are grey. A margin is the exact one of `LoopMargins`; it
is marked at the curve's own crossing. With one sample time both agree; a curve of a loop with several sample times is the part of its
response that keeps the frequency, from which exact margins differ by the part that doesn't.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import atan, degrees, inf, isfinite, isnan, log, log10, nan, pi
from typing import TYPE_CHECKING, Any

import numpy as np

from flexfmu.cosim.design.margins.linear_loop import ComplexArray, LinearLoop
from flexfmu.cosim.design.margins.margins import ALL, LoopMargins, PoseMargins
from flexfmu.cosim.reports.chart import DASHES, GREY, PALETTE, SECOND, Curve, Marker, Panel
from flexfmu.cosim.reports.page import Plot
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.trajectories.jets import RealArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POINTS = 4000
"""Frequencies of a curve."""

GAINS = np.geomspace(0.05, 20.0, 160)
"""Factors of the torques of a root locus."""

NYQUIST = 1.8
"""Half the width of a Nyquist diagram, at least."""

FLOOR, HIGHEST, TURNS = -40.0, 80.0, 720.0
"""Magnitudes [dB] at which the diagram ends, and the largest difference of its phases [degrees]."""

NEAR = log(1.15)
"""Logarithm of the ratio of a curve's margin and the exact one up to which a crossing is that of the margin."""

REAL = 1e-9
"""Imaginary part relative to the magnitude below which a response is real."""

RATIOS = (0.0, 0.1, 0.3, 0.5, 0.7)
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


def margin_plots(poses: Sequence[PoseMargins]) -> tuple[Plot, Plot]:
    """Return the Bode diagram of the open loops, and their Nyquist diagram about -1.

    The former has magnitude [dB] and phase [degrees] over the frequency [Hz], with margins and crossovers; the latter the disk that
    the loop with the smallest disk margin doesn't enter.
    """
    curves = loop_curves(poses)
    label = curves[0].label + ("" if curves[0].is_stable else ": unstable")
    # the loop with the smallest disk margin on top of the others
    others: Mapping[str, Any] = {"label": "other places and cuts", "colour": GREY, "width": 0.8, "opacity": 0.5}
    drawn = [*((each, others) for each in curves[:0:-1]), (curves[0], {"label": label})]
    caption = f"In colour the loop with the smallest disk margin, {curves[0].label}; grey: other places and cuts."
    bode, nyquist = _bode(curves[0], drawn), _nyquist(curves[0], drawn)
    return (
        Plot("bode", "Bode diagram of the open loops", caption, bode, "frequency [Hz]", 330.0),
        Plot("nyquist", "Nyquist diagram about −1", caption, (nyquist,), "real part", 330.0),
    )


def _bode(worst: LoopCurve, drawn: Sequence[tuple[LoopCurve, Mapping[str, Any]]]) -> tuple[Panel, Panel]:
    """Magnitudes and phases."""
    frequency, margins = worst.frequency, worst.margins
    # from a decade below the first crossing to where all magnitudes stay below the floor
    crossings = [0.1 * float(each.gain_crossings[0]) for each, _ in drawn if each.gain_crossings.size]
    first = max(min(crossings, default=0.0), frequency[0])
    above = max(np.flatnonzero(each.decibels > FLOOR).max(initial=0) for each, _ in drawn)
    last = 1.1 * max(
        float(frequency[above]), 10.0 * first, *np.nan_to_num([worst.gain_crossover, worst.phase_crossover])
    )
    inside = (frequency >= first) & (frequency <= last)
    gains, phases, lowest = list[Curve](), list[Curve](), float(worst.phase[inside].max()) - TURNS
    for curve, style in drawn:
        look = {**style, "is_read": curve is worst}
        # other curves by whole turns, so that they begin beside the worst one
        begin, other = (float(np.interp(first, each.frequency, each.phase)) for each in (curve, worst))
        phase = curve.phase - 360.0 * round((begin - other) / 360.0)
        gains.append(
            Curve(frequency[inside], np.where(curve.decibels < HIGHEST, curve.decibels, np.nan)[inside], **look)
        )
        phases.append(Curve(frequency[inside], np.where(phase > lowest, phase, np.nan)[inside], **look))
    # margins are lines between the worst curve and 0 dB or the line of -180 degrees that is next to it
    floor, f, g = FLOOR, worst.gain_crossover, worst.phase_crossover
    if worst.is_stable:
        decibels, angle = 20.0 * log10(margins.gain_margin), degrees(margins.phase_margin)
        at = float(np.interp(g, frequency, worst.phase))
        line = -180.0 if isnan(at) else -180.0 + 360.0 * round((at + 180.0) / 360.0)
        text = f"gain margin {decibels:.3g} dB (× {margins.gain_margin:.3g})"
        gains.append(Curve(np.array([f, f]), np.array([0.0, -decibels]), text, SECOND, 2.4, dot="disc", is_read=False))
        text = f"phase margin {angle:.3g}°, delay margin {1e3 * margins.delay_margin:.3g} ms"
        ends = np.array([line, line + (angle if at > line else -angle)])
        phases.append(Curve(np.array([g, g]), ends, text, SECOND, 2.4, dot="disc", is_read=False))
        floor = min(floor, -decibels - 5.0) if isfinite(decibels) else floor
    marks = [(each, name) for name, each in (("gain margin", f), ("phase margin", g)) if isfinite(each)]
    limits = float(first), float(last)
    return (
        Panel("magnitude [dB]", gains, logarithmic="x", limits=limits, level=0.0, least=floor, marks=marks),
        Panel(
            "phase [°]", phases, logarithmic="x", limits=limits, level=-180.0, marks=[(each, "") for each, _ in marks]
        ),
    )


def disk_of(margin: float) -> tuple[float, float]:
    """The disk that a loop with a disk margin below 2 doesn't enter: its middle on the real axis, and its radius.

    Its diameter lies between the inverses of the gains (2 + margin) / (2 - margin) and (2 - margin) / (2 + margin).
    """
    left, right = -(2.0 + margin) / (2.0 - margin), -(2.0 - margin) / (2.0 + margin)
    return 0.5 * (left + right), 0.5 * (right - left)


def _nyquist(worst: LoopCurve, drawn: Sequence[tuple[LoopCurve, Mapping[str, Any]]]) -> Panel:
    """The plane about -1."""
    margin, angles, shown = worst.margins.disk_margin, np.linspace(0.0, 2.0 * pi, 181), NYQUIST
    circle, curves = np.exp(1j * angles), list[Curve]()
    if 0.0 < margin < 2.0:
        middle, radius = disk_of(margin)
        shown = float(np.clip(1.3 * (radius - middle - 0.6), shown, 4.0))
        gains = f"gains × {(2 - margin) / (2 + margin):.3g} to {(2 + margin) / (2 - margin):.3g}"
        text = f"disk margin {margin:.3g}: {gains}, phases ± {degrees(2.0 * atan(0.5 * margin)):.3g}°"
        curves.append(_area(middle + radius * circle, text))
    elif margin >= 2.0:
        # any gain, and phases up to a right angle: half the plane
        corners = np.array([1j, 1j - 0.6 - shown, -1j - 0.6 - shown, -1j])
        curves.append(_area(corners.real + 1j * shown * corners.imag, "disk margin 2"))
    curves.append(Curve(circle.real, circle.imag, "", GREY, 0.9, dashes=DASHES, is_read=False))
    for each, look in drawn:
        mirrored = list[Curve]()
        # each part of it that is near
        is_near = (np.abs(each.response.real + 0.6) <= shown) & (np.abs(each.response.imag) <= shown)
        for part in np.split(np.arange(is_near.size), np.flatnonzero(np.diff(is_near)) + 1):
            if is_near[part[0]]:
                z, more = each.response[part], {"frequency [Hz]": each.frequency[part]}
                curves.append(Curve(z.real, z.imag, more=more, is_read=each is worst, **look))
                mirrored.append(Curve(z.real, -z.imag, "negative frequencies", width=0.8, dashes=DASHES, is_read=False))
        curves += mirrored if each is worst else []
    critical = Marker(-1.0, 0.0, 7.0, SECOND, text="−1", offset=(6.0, -6.0))
    limits = -0.6 - shown, shown - 0.6
    return Panel("imaginary part", curves, [critical], limits=limits, is_to_scale=True, is_function=False)


def _area(points: ComplexArray, label: str) -> Curve:
    """An area that no curve enters."""
    return Curve(points.real, points.imag, label, SECOND, 0.0, fill=0.25, is_read=False)


def draw_root_locus(poses: Sequence[PoseMargins], linear: Sequence[LinearLoop], title: str) -> Figure:
    """Eigenvalues over a period, in the z-plane, as all torques grow from a twentieth to twenty times their size."""
    from flexfmu.cosim.reports.figure_style import COLOURS, figure_of  # Matplotlib takes longer than most commands

    curves, markers, loci = list[Curve](), list[Marker](), list[tuple[ComplexArray, str]]()
    # lines of equal damping ratio: spirals into the origin, the first one a circle
    turn = np.linspace(-pi, pi, 400)
    for ratio in RATIOS:
        z = np.exp(1j * turn - np.abs(turn) * ratio / np.sqrt(1.0 - ratio**2))
        curves.append(Curve(z.real, z.imag, "", GREY, 0.8 if ratio else 1.4, 0.5 if ratio else 1.0))
        # at a third of a turn, where few eigenvalues are
        x, y = z[333].real, z[333].imag
        markers += [Marker(x, y, colour=GREY, text=f"{ratio:g}", anchor="middle")] if ratio else []
    for k, (pose, loop) in enumerate(zip(poses, linear, strict=True)):
        factors = np.append(1.0, GAINS)[:, np.newaxis] * np.ones(len(loop.channels))
        now, *values = np.linalg.eigvals(loop.lifted.closed(factors))
        curves.append(Curve(now.real, now.imag, pose.place(), PALETTE[k % len(PALETTE)], 0.0, dot="cross"))
        loci.append((np.concatenate(values), curves[-1].colour))
    panel = Panel("imaginary part", curves, markers, is_to_scale=True, is_function=False)
    name = "Torques × 0.05 to 20 (crosses: × 1), lines of equal damping ratio"
    figure = figure_of([Plot("root-locus", name, "", (panel,), "real part", 400.0)], title)
    for points, colour in loci:
        figure.axes[0].plot(points.real, points.imag, ".", markersize=1.5, color=COLOURS[colour])
    figure.axes[0].set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3))
    return figure
