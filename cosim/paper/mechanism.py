"""Drawing the mechanism to scale: links, joints, payload, workspace."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon
from numpy.typing import NDArray

from flexfmu.cosim.paper.colours import SEQUENCE
from flexfmu.cosim.paper.motions import smooth_pieces
from flexfmu.cosim.planning import MotionPlan
from flexfmu.cosim.reports.figure_style import GREY, INK, PALE

Points = NDArray[np.float64]

MILLI = 1e3
"""Drawings are in mm."""


def pose(motion: MotionPlan, time: float) -> Points:
    """Base 1, elbow 1, end effector, elbow 2, base 2 at a time of the motion, (5, 2) [m]."""
    mechanism = motion.scene.mechanism
    end_effector = motion.task.evaluate(np.array([time]), order=0)[0, 0]
    angles = motion.joints.evaluate(np.array([time]), order=0)[0, 0]
    bases = mechanism.base_half_distance * np.array([[-1.0, 0.0], [1.0, 0.0]])
    elbows = bases + mechanism.proximal.length * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.stack([bases[0], elbows[0], end_effector, elbows[1], bases[1]])


def draw_mechanism(axes: Axes, motion: MotionPlan, time: float, *, opacity: float = 1.0) -> None:
    """Draw the robot at a time of the motion [s], the links as thick as they are."""
    points = MILLI * pose(motion, time)
    mechanism = motion.scene.mechanism
    for (start, end), diameter in zip(
        ((points[0], points[1]), (points[4], points[3]), (points[1], points[2]), (points[3], points[2])),
        (mechanism.proximal.diameter,) * 2 + (mechanism.distal.diameter,) * 2,
        strict=True,
    ):
        axes.add_patch(_rod(start, end, MILLI * diameter, opacity))
    for point in points:
        axes.add_patch(Circle((point[0], point[1]), 7.0, facecolor="white", edgecolor=INK, alpha=opacity, zorder=4))


def draw_bases(axes: Axes, motion: MotionPlan) -> None:
    """Mark the two motors."""
    half = MILLI * motion.scene.mechanism.base_half_distance
    for x, name in ((-half, "motor 1"), (half, "motor 2")):
        axes.add_patch(Circle((x, 0.0), 24.0, facecolor=PALE, edgecolor=INK, zorder=1))
        axes.annotate(name, (x, -30.0), ha="center", va="top", fontsize=8, color=INK)


def draw_workspace(axes: Axes, motion: MotionPlan) -> None:
    """Fill what both legs reach and outline it."""
    mechanism = motion.scene.mechanism
    long = mechanism.proximal.length + mechanism.distal.length
    short = abs(mechanism.distal.length - mechanism.proximal.length)
    half = mechanism.base_half_distance
    x, y = np.meshgrid(np.linspace(-1.05 * long, 1.05 * long, 601), np.linspace(-1.05 * long, 1.05 * long, 601))
    distances = [np.hypot(x - base, y) for base in (-half, half)]
    margin = np.min([np.minimum(long - distance, distance - short) for distance in distances], axis=0)
    axes.contourf(MILLI * x, MILLI * y, margin, levels=[0.0, np.inf], colors=[PALE], alpha=0.6)
    axes.contour(MILLI * x, MILLI * y, margin, levels=[0.0], colors=[GREY], linewidths=1.2)


def _rod(start: Points, end: Points, diameter: float, opacity: float) -> Polygon:
    """A rod with round ends from start to end [mm]."""
    direction = np.arctan2(end[1] - start[1], end[0] - start[0])
    angles = direction + np.linspace(0.5 * np.pi, 1.5 * np.pi, 25)
    half_circle = 0.5 * diameter * np.column_stack([np.cos(angles), np.sin(angles)])
    outline = np.concatenate([start + half_circle, end - half_circle])
    return Polygon(outline, facecolor="#c3ccd5", edgecolor=INK, linewidth=0.9, alpha=opacity, zorder=3)


def draw_path(axes: Axes, motion: MotionPlan) -> None:
    """Draw the path with its start and end marked."""
    path = MILLI * np.concatenate([derivatives[0] for _, derivatives in smooth_pieces(motion.task, 201, order=0)])
    axes.plot(path[:, 0], path[:, 1], color=SEQUENCE[1], linewidth=2.0, zorder=6)
    axes.plot(*path[0], "o", color=SEQUENCE[1], markersize=6, zorder=6)
    axes.plot(*path[-1], "s", color=SEQUENCE[1], markersize=6, zorder=6)
    for point, text in ((path[0], "start"), (path[-1], "end")):
        axes.annotate(text, point, xytext=(0, 8), textcoords="offset points", ha="center", fontsize=8, color=INK)
