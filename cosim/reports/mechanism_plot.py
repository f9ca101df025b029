"""The mechanism on its path."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flexfmu.cosim.experiment import Run
from flexfmu.cosim.measuring.bernstein import Array
from flexfmu.cosim.reports.plot_style import FIRST, GREY, INK, SECOND
from flexfmu.model.assembly import bases, elbows

PATH_POINTS = 400


def draw_scene(figure: Figure, run: Run) -> None:
    """The path, and the rigid mechanism at start, middle and end of the motion."""
    axes = figure.subplots()
    task, duration = run.plan.task, run.plan.duration
    path = task.evaluate(np.linspace(0.0, duration, PATH_POINTS), 0)[0]
    axes.plot(path[:, 0], path[:, 1], color=SECOND, linewidth=1.8)
    for fraction, opacity in ((0.0, 1.0), (0.5, 0.25), (1.0, 0.5)):
        _draw_pose(axes, run, task.evaluate(fraction * duration, 0)[0, 0], opacity)
    axes.annotate("start", path[0], xytext=(6, 6), textcoords="offset points", fontsize=8.5)
    axes.annotate("end", path[-1], xytext=(6, 6), textcoords="offset points", fontsize=8.5)
    _draw_bases(axes, run.scene.mechanism.base_half_distance)
    axes.set_aspect("equal", anchor="N")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _draw_pose(axes: Axes, run: Run, position: Array, opacity: float) -> None:
    """Both legs: base, elbow, end effector."""
    mechanism = run.scene.mechanism
    end_effector = (float(position[0]), float(position[1]))
    for base, elbow in zip(bases(mechanism), elbows(mechanism, end_effector), strict=True):
        axes.plot(*_line(base, elbow), color=INK, linewidth=3.2, alpha=opacity, solid_capstyle="round")
        axes.plot(*_line(elbow, end_effector), color=FIRST, linewidth=2.2, alpha=opacity, solid_capstyle="round")
        axes.plot(*elbow, "o", color=INK, markersize=4, alpha=opacity)
    axes.plot(*end_effector, "o", color=SECOND, markersize=6, alpha=max(opacity, 0.6))


def _line(start: tuple[float, float], end: tuple[float, float]) -> tuple[tuple[float, float], tuple[float, float]]:
    """x and y of both ends."""
    return (start[0], end[0]), (start[1], end[1])


def _draw_bases(axes: Axes, half_distance: float) -> None:
    """The motors, leg 1 at -a."""
    for leg, x in ((1, -half_distance), (2, half_distance)):
        axes.plot(x, 0.0, "s", color=GREY, markersize=9)
        axes.annotate(f"motor {leg}", (x, 0.0), xytext=(0, -14), textcoords="offset points", ha="center", fontsize=8.5)
