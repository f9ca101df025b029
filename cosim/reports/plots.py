"""Plots of a run's report: the mechanism on its path, joint references, torques, errors, deflections and residual vibration."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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
from flexfmu.cosim.reports.figure_style import PAGE_GREY, SECOND, mark_time, page_style, to_svg
from flexfmu.cosim.reports.figure_style import draw as draw_empty
from flexfmu.cosim.reports.mechanism_figure import draw_lines

POINTS = 3000
"""Approximate number of points of a curve, as many as a plot of this size resolves."""


@dataclass(frozen=True)
class Plot:
    """A plot of the report.

    Attributes:
        key: short identifier.
        title, caption: heading, and one sentence on the plot.
        svg: an SVG element.
    """

    key: str
    title: str
    caption: str
    svg: str


def draw_plots(run: Run, end_equilibrium: RealArray | None) -> Iterator[Plot]:
    """Yield the plots for which the run has the signals, the scene first.

    Args:
        run: a run, complete or not.
        end_equilibrium: (2,) end effector in static equilibrium at the end pose [m]; None if unknown, which omits the dwell.
    """
    with page_style():
        yield _plot(
            "scene", "Scene", "The rigid mechanism at start, middle and end of the path.", (5.2, 3.5), draw_scene, run
        )
        # a run that ended at its start has no curves
        if np.count_nonzero(np.diff(run.recording.time) > 0.0) == 0:
            return
        yield _plot("references", "Joint references", "What drives the robot.", (5.2, 3.9), _draw_references, run)
        yield _plot("torques", "Motor torques", "Positive counter-clockwise.", (5.2, 2.7), _draw_torques, run)
        if all(name in run.recording.columns for name in JOINT_POSITIONS):
            caption = "Angle minus planned angle of each motor."
            yield _plot("tracking", "Tracking error", caption, (5.2, 2.7), _draw_tracking_error, run)
        if any(name in run.recording.columns for name in TIP_DEFLECTIONS):
            caption = "Transverse displacement of the proximal links' tips."
            yield _plot("deflections", "Tip deflections", caption, (5.2, 2.7), _draw_deflections, run)
        # errors against the rigid robot
        caption = "Distance of the end effector from the rigid robot's, which tracks its path exactly."
        yield _plot("position", "Position error", caption, (5.2, 2.7), _draw_position_error, run)
        caption = "Norm of the deviation from the rigid robot's acceleration."
        yield _plot("acceleration", "Acceleration error", caption, (5.2, 2.7), _draw_acceleration_error, run)
        # the dwell, if the run reached it
        if run.recording.time[-1] > run.plan.duration and end_equilibrium is not None:
            caption = "Distance from the static equilibrium at the end pose during the dwell, and the settling band."
            yield _plot(
                "dwell", "Residual vibration", caption, (5.2, 2.7), lambda f, r: _draw_dwell(f, r, end_equilibrium), run
            )


def _plot(
    key: str, title: str, caption: str, size: tuple[float, float], draw: Callable[[Figure, Run], None], run: Run
) -> Plot:
    figure = draw_empty(*size)
    draw(figure, run)
    return Plot(key, title, caption, to_svg(figure, key, title))


def _draw_references(figure: Figure, run: Run) -> None:
    """Draw the reference position, velocity and acceleration of both joints."""
    axes = figure.subplots(3, 1, sharex=True)
    time = run.recording.time
    for panel, kind, unit in zip(
        axes, ("position", "velocity", "acceleration"), ("rad", "rad/s", "rad/s²"), strict=True
    ):
        for joint in (1, 2):
            panel.plot(time, run.recording[f"joint{joint}.reference.{kind}"].values, label=f"joint {joint}")
        panel.set_ylabel(f"{kind}\n[{unit}]")
    _time_axis(axes[-1], run)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)


def _draw_torques(figure: Figure, run: Run) -> None:
    _draw_pair(figure, run, TORQUES, ("joint 1", "joint 2"), "torque [N·m]", 1.0)


def _draw_tracking_error(figure: Figure, run: Run) -> None:
    axes = figure.subplots()
    for joint in (0, 1):
        time, values = _curve(joint_error(run.recording, joint, run.plan.joints))
        axes.plot(time, 1e3 * values[:, 0], label=f"joint {joint + 1}")
    axes.set_ylabel("error [mrad]")
    figure.legend(loc="outside upper right", ncols=2)
    _time_axis(axes, run)


def _draw_deflections(figure: Figure, run: Run) -> None:
    _draw_pair(figure, run, TIP_DEFLECTIONS, ("link 1", "link 2"), "deflection [mm]", 1e3)


def _draw_pair(
    figure: Figure, run: Run, names: tuple[str, ...], labels: tuple[str, ...], axis: str, factor: float
) -> None:
    """Draw two signals of the same unit, interpolated between the communication points."""
    axes = figure.subplots()
    for name, label in zip(names, labels, strict=True):
        if name in run.recording.columns:
            time, values = _curve(segments(run.recording, [name]))
            axes.plot(time, factor * values[:, 0], label=label)
    axes.set_ylabel(axis)
    figure.legend(loc="outside upper right", ncols=2)
    _time_axis(axes, run)


def _draw_position_error(figure: Figure, run: Run) -> None:
    _draw_norm(figure, run, deviation_from_rigid(position(run.recording), run.plan.task), "error [mm]", 1e3)


def _draw_acceleration_error(figure: Figure, run: Run) -> None:
    motion = position(run.recording).within(0.0, run.plan.duration)
    _draw_norm(figure, run, deviation_from_rigid(motion, run.plan.task), "error [m/s²]", 1.0, order=2)


def _draw_dwell(figure: Figure, run: Run, end_equilibrium: RealArray) -> None:
    vibration = deviation_from_point(position(run.recording), end_equilibrium).within(run.plan.duration, np.inf)
    axes = _draw_norm(figure, run, vibration, "distance [µm]", 1e6)
    axes.axhline(1e6 * run.scene.cosimulation.settling_band, color=PAGE_GREY, linewidth=0.9, linestyle=(0, (4, 3)))
    axes.set_xlim(run.plan.duration, run.recording.time[-1])


def _draw_norm(figure: Figure, run: Run, signal: HermiteSegments, label: str, factor: float, order: int = 0) -> Axes:
    """Draw the norm of a signal's time derivative of the given order."""
    axes = figure.subplots()
    time, values = _curve(signal, order)
    axes.plot(time, factor * np.linalg.norm(values, axis=1))
    axes.set_ylabel(label)
    axes.set_ylim(bottom=0.0)
    _time_axis(axes, run)
    return axes


def _curve(signal: HermiteSegments, order: int = 0) -> tuple[RealArray, RealArray]:
    """Return times (N,) [s] and values (N, m) of a signal's derivative, dense enough for a smooth curve."""
    return sample(signal, int(np.clip(POINTS // max(len(signal.start), 1), 2, 20)), order)


def _time_axis(axes: Axes, run: Run) -> None:
    axes.set_xlabel("time [s]")
    axes.margins(x=0.01)
    if axes.dataLim.x0 < run.plan.duration < axes.dataLim.x1:
        mark_time(axes, run.plan.duration, "end of motion")


PATH_POINTS = 400


def draw_scene(figure: Figure, run: Run) -> None:
    """Draw the path, and the rigid mechanism at start, middle and end of the motion."""
    axes = figure.subplots()
    task, duration = run.plan.task, run.plan.duration
    path = task.evaluate(np.linspace(0.0, duration, PATH_POINTS), 0)[0]
    axes.plot(path[:, 0], path[:, 1], color=SECOND, linewidth=1.8)
    axes.annotate("start", path[0], xytext=(6, 6), textcoords="offset points", fontsize=8.5)
    axes.annotate("end", path[-1], xytext=(6, 6), textcoords="offset points", fontsize=8.5)
    positions = task.evaluate(np.array([0.0, 0.5, 1.0]) * duration, 0)[0]
    draw_lines(axes, run.scene.mechanism, zip(positions, (1.0, 0.25, 0.5), strict=True))
    axes.set_aspect("equal", anchor="N")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
