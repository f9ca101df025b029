"""Drawing of the rigid mechanism with links and hinges to scale, for the paper's figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.reports.figure_style import INK, PALE
from flexfmu.model.scene.assembly import bases, elbows
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.trajectories.curves import Point

MILLI = 1e3
"""Factor from m to mm, the unit of drawings to scale."""

HINGE_RADIUS, MOTOR_RADIUS = 7.0, 24.0
"""Radii in drawings to scale [mm]."""


def draw_to_scale(axes: Axes, mechanism: Mechanism, poses: Iterable[tuple[RealArray, float]]) -> None:
    """Draw links with their true diameters, hinges and motors [mm].

    Args:
        axes: axes to draw on.
        mechanism: lengths and working mode.
        poses: positions of the end effector (2,) [m], each with the opacity of the pose.
    """
    proximal, distal = MILLI * mechanism.proximal.diameter, MILLI * mechanism.distal.diameter
    for legs, end, opacity in _poses(mechanism, poses):
        # proximal links first, hinges on top
        rods = [(base, elbow, proximal) for base, elbow in legs] + [(elbow, end, distal) for _, elbow in legs]
        for start, stop, diameter in rods:
            axes.add_patch(_rod(MILLI * np.array(start), MILLI * np.array(stop), diameter, opacity))
        (base1, elbow1), (base2, elbow2) = legs
        for x, y in (base1, elbow1, end, elbow2, base2):
            hinge = (MILLI * x, MILLI * y)
            axes.add_patch(Circle(hinge, HINGE_RADIUS, facecolor="white", edgecolor=INK, alpha=opacity, zorder=4))
    # motors behind
    for leg, (x, y) in enumerate(bases(mechanism), start=1):
        axes.add_patch(Circle((MILLI * x, MILLI * y), MOTOR_RADIUS, facecolor=PALE, edgecolor=INK, zorder=1))
        axes.annotate(f"motor {leg}", (MILLI * x, -30.0), ha="center", va="top", fontsize=8, color=INK)


def _poses(
    mechanism: Mechanism, poses: Iterable[tuple[RealArray, float]]
) -> Iterator[tuple[list[tuple[Point, Point]], Point, float]]:
    """Yield for each pose base and elbow of both legs [m], the end effector [m], and the opacity."""
    for position, opacity in poses:
        end = float(position[0]), float(position[1])
        yield list(zip(bases(mechanism), elbows(mechanism, end), strict=True)), end, opacity


def _rod(start: RealArray, end: RealArray, diameter: float, opacity: float) -> Polygon:
    """Return a rod with round ends from start to end [mm]."""
    direction = np.arctan2(end[1] - start[1], end[0] - start[0])
    angles = direction + np.linspace(0.5 * np.pi, 1.5 * np.pi, 25)
    half_circle = 0.5 * diameter * np.column_stack([np.cos(angles), np.sin(angles)])
    outline = np.concatenate([start + half_circle, end - half_circle])
    return Polygon(outline, facecolor="#c3ccd5", edgecolor=INK, linewidth=0.9, alpha=opacity, zorder=3)
