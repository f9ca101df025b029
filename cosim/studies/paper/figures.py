"""The figures of paths, profiles and simulations: blends (Fig. 6), motion profiles (Fig. 7), placement in the workspace (Fig. 9),
path-tracking error (Fig. 12), and one picture that sums the experiment up; the mechanism is drawn to scale.

Drawing of the rigid mechanism with links and hinges to scale, for the paper's figures.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.cosim.reports.figure_style import GREY, INK, PALE, draw, mark_end
from flexfmu.cosim.studies.paper.comparison import ComparisonTable
from flexfmu.cosim.studies.paper.computed import PaperCase, SimulatedCase, case_scene, smooth_pieces, trajectory_scene
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


PROFILE_COLOURS: Mapping[str, str] = {
    "7th order polynomial": "#0b5fa5",
    "Bang-bang": "#d1495b",
    "1/4 Trapezoidal": "#2a9d6f",
    "1/8 Trapezoidal": "#e09f1f",
}
"""Label of a motion profile → colour; distinct for colour-blind readers in lightness too."""

CURVE_COLOURS: Mapping[str, str] = {"Lamé": "#0b5fa5", "Clothoid": "#d1495b", "Polar": "#2a9d6f"}
"""Label of a curve → colour."""

SEQUENCE = ("#0b5fa5", "#d1495b", "#2a9d6f")
"""Colours of lines that differ in a number (cycle times, blend lengths)."""


def draw_robot(axes: Axes, motion: MotionPlan) -> None:
    """Draw the robot at the start, the middle and the end of the motion (paler from one to the next), its motors and its path."""
    positions = motion.task.evaluate(np.array([0.0, 0.5, 1.0]) * motion.duration, order=0)[0]
    draw_to_scale(axes, motion.scene.mechanism, zip(positions, (1.0, 0.35, 0.15), strict=True))
    # path with start and end marked
    path = MILLI * np.concatenate([derivatives[0] for _, derivatives in smooth_pieces(motion.task, 201, order=0)])
    axes.plot(path[:, 0], path[:, 1], color=SEQUENCE[1], linewidth=2.0, zorder=6)
    axes.plot(*path[0], "o", color=SEQUENCE[1], markersize=6, zorder=6)
    axes.plot(*path[-1], "s", color=SEQUENCE[1], markersize=6, zorder=6)
    for point, text in ((path[0], "start"), (path[-1], "end")):
        axes.annotate(text, point, xytext=(0, 8), textcoords="offset points", ha="center", fontsize=8, color=INK)


def draw_workspace(axes: Axes, motion: MotionPlan) -> None:
    """Fill what both legs reach and outline it."""
    mechanism = motion.scene.mechanism
    long = mechanism.proximal.length + mechanism.distal.length
    short = abs(mechanism.distal.length - mechanism.proximal.length)
    half = mechanism.base_half_distance
    # the workspace is where both legs reach, neither fully stretched nor folded
    x, y = np.meshgrid(np.linspace(-1.05 * long, 1.05 * long, 601), np.linspace(-1.05 * long, 1.05 * long, 601))
    distances = [np.hypot(x - base, y) for base in (-half, half)]
    margin = np.min([np.minimum(long - distance, distance - short) for distance in distances], axis=0)
    axes.contourf(MILLI * x, MILLI * y, margin, levels=[0.0, np.inf], colors=[PALE], alpha=0.6)
    axes.contour(MILLI * x, MILLI * y, margin, levels=[0.0], colors=[GREY], linewidths=1.2)


POLYNOMIAL = "7th order polynomial"

SHOWN = 28.0
"""Part of the crossing shown beside the corner [mm]."""

PIECE = 401
"""Points drawn between two breakpoints."""


def blends() -> Figure:
    """Fig. 6: the three blends of 25 mm overlaid, in the corner that they round."""
    drawing = draw(5.2, 4.6)
    axes = drawing.add_subplot()
    for curve, colour in CURVE_COLOURS.items():
        # each curve rounds the same corner
        x, y = _corner(curve)
        axes.plot(x, y, color=colour, label=curve)
    axes.plot([0.0, 0.0, SHOWN], [-25.0, 0.0, 0.0], color=GREY, linestyle=":", linewidth=1.2, label="sharp corner")
    axes.set(
        xlabel="along the crossing [mm]",
        ylabel="along the lift [mm]",
        aspect="equal",
        title="Blends with d = e = 25 mm",
    )
    axes.legend(loc="lower right")
    return drawing


def motion_profiles() -> Figure:
    """Fig. 7: fraction of the path, its rate and its second derivative for a cycle time of 1 s."""
    drawing = draw(6.4, 6.6)
    panels = drawing.subplots(3, 1, sharex=True)
    for label, colour in PROFILE_COLOURS.items():
        task = plan(trajectory_scene(label, "Lamé")).profiled
        # times (N,) [s] and fraction of the path with two derivatives (3, N), jumps with both their sides
        etas = [np.linspace(piece.start, piece.end, PIECE) for piece in task.profile.pieces]
        jets = [
            piece.jet(eta, 2).rescale(1.0 / task.duration) for piece, eta in zip(task.profile.pieces, etas, strict=True)
        ]
        time = task.duration * np.concatenate(etas)
        derivatives = np.concatenate([jet.derivatives() for jet in jets], axis=1)
        for panel, values in zip(panels, derivatives, strict=True):
            panel.plot(time, values, color=colour, label=label)
    for panel, unit in zip(panels, ("position s", "velocity ds/dt [1/s]", "acceleration d²s/dt² [1/s²]"), strict=True):
        panel.set_ylabel(unit)
    panels[0].set_title("Motion profiles for a cycle time of 1 s")
    panels[0].legend(loc="upper left")
    panels[-1].set_xlabel("time [s]")
    return drawing


def _corner(curve: str) -> tuple[RealArray, RealArray]:
    """The path around its first corner, which is the origin: along the crossing and along the lift [mm]."""
    # axes along the lift and the crossing, the corner as origin
    motion = plan(trajectory_scene(POLYNOMIAL, curve))
    path = motion.profiled.path
    lift = np.array(path.lift) / np.hypot(*path.lift)
    points = np.concatenate([derivatives[0] for _, derivatives in smooth_pieces(motion.task, PIECE, order=0)])
    offset = MILLI * (points - np.array(path.start) - path.height * lift)
    crossing = np.abs(offset @ np.array([-lift[1], lift[0]]))
    near = crossing <= SHOWN
    return crossing[near], (offset @ lift)[near]


def placement() -> Figure:
    """Fig. 9: the path in the workspace, with the mechanism at the start, the middle and the end of the motion."""
    drawing = draw(7.4, 6.6)
    axes = drawing.add_subplot()
    motion = plan(trajectory_scene(POLYNOMIAL, "Lamé"))
    draw_workspace(axes, motion)
    draw_robot(axes, motion)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", title="The path in the workspace")
    axes.annotate("reached by both legs", (0.0, 480.0), ha="center", fontsize=8.5, color=GREY)
    return drawing


HEAVY_SCENE = "barnard2012-6kg"


def path_errors(simulations: Mapping[PaperCase, SimulatedCase]) -> Figure:
    """Fig. 12: norm of the position error for the payload of 6 kg, one panel for each curve."""
    drawing = draw(7.6, 8.2)
    panels = drawing.subplots(3, 1, sharex=True, sharey=True)
    for panel, curve in zip(panels, CURVE_COLOURS, strict=True):
        draw_errors(panel, simulations, curve)
        panel.set_title(curve)
    drawing.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(PROFILE_COLOURS))
    panels[-1].set_xlabel("time [s]")
    return drawing


def draw_errors(axes: Axes, simulations: Mapping[PaperCase, SimulatedCase], curve: str) -> None:
    """Draw the position error of every motion profile on one curve."""
    for profile, colour in PROFILE_COLOURS.items():
        simulation = simulations[HEAVY_SCENE, profile, curve]
        axes.plot(simulation.time, 1e3 * simulation.path_error, color=colour, label=profile, linewidth=1.2)
    axes.set(ylabel="position error [mm]", xlim=(0.0, simulation.time[-1]))
    axes.set_ylim(bottom=0.0)
    mark_end(axes, simulation.duration)


PARITY = {
    "peak_torque_1": ("torque [N m]", "o"),
    "rms_acceleration_error": ("RMS acceleration error [m/s²]", "s"),
    "peak_modal_deflection_1": ("deflection [µm]", "^"),
}
"""Metric of Tables 7 and 9 → label and marker."""

ROOM_FOR_LEGEND = 1.35
"""Upper limit of the error axis over the largest error."""

UNITS = {"mm": 1e3}
"""Unit → factor by which its figures are shown, so that all metrics share one pair of axes; 1 for the others."""


def overview(simulations: Mapping[PaperCase, SimulatedCase], tables: Sequence[ComparisonTable]) -> Figure:
    """Draw the overview for the README: robot and path, path error, printed and computed figures."""
    drawing = draw(11.0, 5.0)
    grid = drawing.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    # the robot at the left
    robot = drawing.add_subplot(grid[:, 0])
    draw_robot(robot, plan(case_scene(HEAVY_SCENE, POLYNOMIAL, "Lamé")))
    robot.set(xlabel="x [mm]", ylabel="y [mm]", title="The five-bar robot and its pick-and-place path", aspect="equal")
    robot.set(xlim=(-400.0, 400.0), ylim=(-85.0, 375.0))
    # path error above, printed and computed figures below
    errors = drawing.add_subplot(grid[0, 1])
    draw_errors(errors, simulations, "Lamé")
    errors.set(xlabel="time [s]", title="What elasticity leaves: 6 kg in 0.43 s")
    errors.set_ylim(top=ROOM_FOR_LEGEND * errors.get_ylim()[1])
    errors.legend(loc="upper left", fontsize=8, ncols=2, handlelength=1.2, columnspacing=1.0)
    _parity(drawing.add_subplot(grid[1, 1]), tables)
    return drawing


def _parity(axes: Axes, tables: Sequence[ComparisonTable]) -> None:
    """Computed over printed figures on equal axes; a misprint is hollow."""
    # points of both tables, a colour and a marker for each metric
    chosen = [table for table in tables if table.printed.key in ("table-07", "table-09")]
    for (metric, (label, marker)), colour in zip(PARITY.items(), CURVE_COLOURS.values(), strict=True):
        cells = [
            (UNITS.get(comparison.quantity.unit, 1.0), cell)
            for comparison in (table.comparison(metric) for table in chosen)
            for cell in comparison.cells
        ]
        points = [(scale * float(cell.printed), scale * cell.computed) for scale, cell in cells if cell.believable]
        axes.loglog(
            *np.transpose(points), marker, color=colour, label=label, markersize=5, alpha=0.8, markeredgewidth=0
        )
        for scale, cell in cells:
            if not cell.believable:
                point = (scale * float(cell.printed), scale * cell.computed)
                axes.loglog(*point, marker, markerfacecolor="white", markeredgecolor=colour, markersize=5)
                axes.annotate(
                    "misprint", point, xytext=(-8, -3), textcoords="offset points", ha="right", fontsize=8, color=GREY
                )
    # equal axes with the line of agreement
    limits = np.array([2.0, 220.0])
    axes.plot(limits, limits, color=GREY, linewidth=1.0, zorder=1)
    axes.set(xlim=limits, ylim=limits, xlabel="printed in the paper", ylabel="computed through the FMU")
    axes.set_title("Tables 7 and 9: 72 figures", color=INK)
    axes.legend(loc="upper left", fontsize=8)
