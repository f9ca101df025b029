"""Plots of a run's report: the mechanism on its path, joint references, torques, errors, deflections and residual vibration."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.prepared_scene import Run
from flexfmu.cosim.metrics.segments import HermiteSegments
from flexfmu.cosim.metrics.signals import (
    JOINT_POSITIONS,
    TIP_DEFLECTIONS,
    TORQUES,
    deviation_from_point,
    deviation_from_rigid,
    joint_error,
    position,
    sample,
    segments,
)
from flexfmu.cosim.reports.chart import Curve, Panel
from flexfmu.cosim.reports.motion_picture import LONGEST, bent_robot, path_panel
from flexfmu.cosim.reports.motors import motor_plots
from flexfmu.cosim.reports.page import WIDTH, Plot
from flexfmu.cosim.reports.scene_picture import scene_panel
from flexfmu.cosim.reports.spectrum import spectrum, spectrum_caption, spectrum_panel
from flexfmu.cosim.reports.svg import FIRST, SECOND

POINTS = 3000
"""Approximate number of points of a curve, as many as a plot of this size resolves."""

REFERENCES_HEIGHT = 280.8
"""Height of a plot [pt]."""

BESIDE, BESIDES = 55.0, 70.0
"""Space beside and above or below the panel of a plot to scale, about [pt]."""

COLOURS = (FIRST, SECOND)
"""Of the curves of joints and links 1 and 2."""


def draw_plots(run: Run, end_equilibrium: RealArray | None) -> Iterator[Plot]:
    """Yield the plots for which the run has the signals, the scene first.

    Args:
        run: a run, complete or not.
        end_equilibrium: (2,) end effector in static equilibrium at the end pose [m]; None if unknown, which omits the dwell.
    """
    # a run that ended at its start has no curves
    columns, caption = run.recording.columns, "The rigid mechanism at start, middle and end of the path."
    if np.count_nonzero(np.diff(run.recording.time) > 0.0) == 0:
        yield _to_scale("scene", "Scene", caption, scene_panel(run.plan))
        return
    robot = bent_robot(run)
    caption += " With scripts it moves, its deviation from the rigid robot magnified."
    yield _to_scale("scene", "Scene", caption, scene_panel(run.plan, robot.data()))
    last = f" in the last {LONGEST:g} s" if np.ptp(run.recording.time) > LONGEST else ""
    caption = f"Path of the end effector{last}; its deviation from the rigid robot × {robot.magnification:g}."
    yield _to_scale("path", "Path", caption, path_panel(run, robot.magnification))
    yield Plot("references", "Joint references", "What drives the robot.", _references(run), height=REFERENCES_HEIGHT)
    torques = _pair(run, TORQUES, "joint", "torque [N·m]", 1.0)
    yield Plot("torques", "Motor torques", "Positive counter-clockwise.", (torques,))
    yield from motor_plots(run)
    if all(name in columns for name in JOINT_POSITIONS):
        yield Plot("tracking", "Tracking error", "Angle minus planned angle of each motor.", (_tracking_error(run),))
    if any(name in columns for name in TIP_DEFLECTIONS):
        caption = "Transverse displacement of the proximal links' tips."
        deflections = _pair(run, TIP_DEFLECTIONS, "link", "deflection [mm]", 1e3)
        yield Plot("deflections", "Tip deflections", caption, (deflections,))
    # errors against the rigid robot
    caption = "Distance of the end effector from the rigid robot's, which tracks its path exactly."
    deviation = deviation_from_rigid(position(run.recording), run.plan.task)
    yield Plot("position", "Position error", caption, (_norm(run, deviation, "error [mm]", 1e3),))
    caption = "Norm of the deviation from the rigid robot's acceleration."
    moving = deviation_from_rigid(position(run.recording).within(0.0, run.plan.duration), run.plan.task)
    yield Plot("acceleration", "Acceleration error", caption, (_norm(run, moving, "error [m/s²]", 1.0, order=2),))
    # the dwell, if the run reached it
    if run.recording.time[-1] > run.plan.duration and end_equilibrium is not None:
        caption = "Distance from the static equilibrium at the end pose during the dwell, and the settling band."
        yield Plot("dwell", "Residual vibration", caption, (_dwell(run, end_equilibrium),))
        caption = spectrum_caption("Deviation of the end effector from the static equilibrium over the dwell")
        panel = _spectrum(run, end_equilibrium)
        caption += " Dashed: natural frequencies, motors locked." if panel.marks else ""
        if panel.curves:
            yield Plot("spectrum", "Spectrum of the residual vibration", caption, (panel,), "frequency [Hz]")


def _to_scale(key: str, title: str, caption: str, panel: Panel) -> Plot:
    """Return a plot of a panel to scale [m], as high as that is."""
    spans = [np.ptp(np.concatenate([getattr(curve, axis) for curve in panel.curves])) for axis in "xy"]
    return Plot(key, title, caption, (panel,), "x [m]", BESIDES + (WIDTH - BESIDE) * float(spans[1] / spans[0]))


def _references(run: Run) -> tuple[Panel, ...]:
    """Return reference position, velocity and acceleration of both joints."""
    panels, time = [], run.recording.time
    for kind, unit in (("position", "rad"), ("velocity", "rad/s"), ("acceleration", "rad/s²")):
        values = [run.recording[f"joint{joint}.reference.{kind}"].values for joint in (1, 2)]
        curves = [
            Curve(time, each, f"joint {joint}", colour)
            for joint, each, colour in zip((1, 2), values, COLOURS, strict=True)
        ]
        panels.append(
            Panel(label=f"{kind}\n[{unit}]", curves=curves, marks=_marks(time, run) if kind == "acceleration" else ())
        )
    return tuple(panels)


def _pair(run: Run, names: tuple[str, ...], of: str, label: str, factor: float) -> Panel:
    """Return two signals of the same unit, interpolated between the communication points."""
    curves = []
    for number, (name, colour) in enumerate(zip(names, COLOURS, strict=True), start=1):
        if name in run.recording.columns:
            time, values = _curve(segments(run.recording, [name]))
            curves.append(Curve(time, factor * values[:, 0], f"{of} {number}", colour))
    return Panel(label=label, curves=curves, marks=_marks(run.recording.time, run))


def _tracking_error(run: Run) -> Panel:
    curves = []
    for joint, colour in enumerate(COLOURS):
        time, values = _curve(joint_error(run.recording, joint, run.plan.joints))
        curves.append(Curve(time, 1e3 * values[:, 0], f"joint {joint + 1}", colour))
    return Panel(label="error [mrad]", curves=curves, marks=_marks(run.recording.time, run))


def _dwell(run: Run, end_equilibrium: RealArray) -> Panel:
    """Return the distance from rest during the dwell, with the settling band."""
    vibration = deviation_from_point(position(run.recording), end_equilibrium).within(run.plan.duration, np.inf)
    limits = run.plan.duration, float(run.recording.time[-1])
    panel = _norm(run, vibration, "distance [µm]", 1e6)
    return replace(panel, level=1e6 * run.scene.cosimulation.settling_band, limits=limits)


def _spectrum(run: Run, end_equilibrium: RealArray) -> Panel:
    """Return the spectra of both components of the residual vibration [µm], with the natural frequencies where the motors are locked."""
    vibration = deviation_from_point(position(run.recording), end_equilibrium).within(run.plan.duration, np.inf)
    time, values = _curve(vibration)
    curves = []
    for axis, colour in enumerate(COLOURS):
        found = spectrum(time, values[:, axis], run.plan.duration)
        if found is not None:
            curves.append(Curve(found[0], 1e6 * found[1], "xy"[axis], colour))
    frequencies = [] if run.rests is None else run.rests.frequencies(run.parameters).tolist()
    marks = [(frequency, f"{number}") for number, frequency in enumerate(frequencies, start=1)]
    return spectrum_panel("amplitude [µm]", curves, marks)


def _norm(run: Run, signal: HermiteSegments, label: str, factor: float, order: int = 0) -> Panel:
    """Return the norm of a signal's time derivative of the given order."""
    time, values = _curve(signal, order)
    curve = Curve(time, factor * np.linalg.norm(values, axis=1))
    return Panel(label=label, curves=[curve], from_zero=True, marks=_marks(time, run))


def _curve(signal: HermiteSegments, order: int = 0) -> tuple[RealArray, RealArray]:
    """Return times (N,) [s] and values (N, m) of a signal's derivative, dense enough for a smooth curve."""
    return sample(signal, int(np.clip(POINTS // max(len(signal.start), 1), 2, 20)), order)


def _marks(time: RealArray, run: Run) -> list[tuple[float, str]]:
    """Return the mark at the end of the motion, if it lies between the times (N,) [s]."""
    end = run.plan.duration
    return [(end, "end of motion")] if time[0] < end < time[-1] else []
