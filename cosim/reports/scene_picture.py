"""The report's picture of the scene: the path, and the rigid mechanism at start, middle and end of the motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.reports.chart import Curve, Marker, Panel
from flexfmu.cosim.reports.svg import FIRST, GREY, INK, SECOND
from flexfmu.model.scene.assembly import bases, elbows
from flexfmu.trajectories.curves import Point

PATH_POINTS = 400

POSES = ((0.0, 1.0), (0.5, 0.25), (1.0, 0.5))
"""Fractions of the duration at which the mechanism is drawn, each with its opacity."""


POSE = "pose"
"""Class of what is hidden while the mechanism moves."""


def scene_panel(plan: MotionPlan, data: Mapping[str, str] | None = None) -> Panel:
    """Return the path and the mechanism, to scale [m]; the poses are hidden where the page's script animates ``data``."""
    plan = plan.once
    path = plan.task.evaluate(np.linspace(0.0, plan.duration, PATH_POINTS), 0)[0]
    path_curve = Curve(path[:, 0], path[:, 1], colour=SECOND, width=1.8, opacity=0.6, is_read=False)
    curves, markers = [path_curve], list[Marker]()
    markers += [Marker(*_point(path[i]), text=text, offset=(6.0, -6.0)) for i, text in ((0, "start"), (-1, "end"))]
    # links as lines, elbows and end effector as discs
    for fraction, opacity in POSES:
        end = _point(plan.task.evaluate(np.array([fraction * plan.duration]), 0)[0, 0])
        for base, elbow in zip(bases(plan.scene.mechanism), elbows(plan.scene.mechanism, end), strict=True):
            curves += [_link(base, elbow, INK, 3.2, opacity), _link(elbow, end, FIRST, 2.2, opacity)]
            markers.append(Marker(*elbow, size=5.0, opacity=opacity, group=POSE))
        markers.append(Marker(*end, size=7.0, colour=SECOND, opacity=max(opacity, 0.6), group=POSE))
    # motors on top
    for leg, base in enumerate(bases(plan.scene.mechanism), start=1):
        below = Marker(*base, text=f"motor {leg}", offset=(0.0, 14.0), anchor="middle")
        markers += [Marker(*base, size=10.0, colour=GREY, shape="square"), below]
    return Panel(label="y [m]", curves=curves, markers=markers, is_to_scale=True, is_function=False, data=data or {})


def _link(start: Point, end: Point, colour: str, width: float, opacity: float) -> Curve:
    x, y = np.array([start, end]).T
    return Curve(x, y, colour=colour, width=width, opacity=opacity, is_read=False, group=POSE)


def _point(position: RealArray) -> Point:
    return float(position[0]), float(position[1])
