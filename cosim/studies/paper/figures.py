"""The paper's figures: blends (Fig. 6), motion profiles (7), joint motion and its spectrum (8), placement in the workspace (9),
spectra over cycle times (10) and blend lengths (11), path-tracking error (12), and a picture that sums the experiment up.

A motion excites the links at the frequencies that its acceleration contains. Its spectrum is the periodogram of the acceleration
over a window that all motions share (Oppenheim and Schafer, Discrete-Time Signal Processing, ch. 10), without a taper, since the
signal is zero at both ends.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.signal import periodogram

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.cosim.reports.figure_style import GREY, INK, PALE, draw, mark_end
from flexfmu.cosim.studies.paper.tables import (
    POLYNOMIAL,
    TRAJECTORY_SCENE,
    PaperCase,
    PaperTable,
    SimulatedCase,
    case_scene,
    smooth_pieces,
    trajectory_scene,
)
from flexfmu.model.scene.assembly import bases, elbows
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.trajectory import Trajectory

MILLI = 1e3
"""Factor from m to mm, the unit of drawings."""

COLOURS = ("#0b5fa5", "#d1495b", "#2a9d6f", "#e09f1f")
"""Of lines; distinct for colour-blind readers in lightness too."""

PROFILES = (POLYNOMIAL, "Bang-bang", "1/4 Trapezoidal", "1/8 Trapezoidal")
CURVES = ("Lamé", "Clothoid", "Polar")
"""Labels of the motion profiles and of the curves that are drawn."""

SHOWN = 28.0
"""Part of the crossing shown beside the corner [mm]."""

PIECE = 401
"""Points drawn between two breakpoints."""

SAMPLING_FREQUENCY = 20_000.0
"""Sampling frequency of spectra [Hz], 100 times the highest one shown, so that aliasing of jumps stays below 1e-4."""

WINDOW = 4.0
"""Length of the window of spectra [s]: the motion, then standstill; the same for all motions, so that densities compare."""

HIGHEST_FREQUENCY = 200.0
"""Frequencies shown [Hz]: beyond the first natural frequency of the robot with the light payload."""

DECADES = 10.0
"""Decades of the density shown below its maximum."""

FIRST_FREQUENCIES = ((58.0, "6 kg"), (126.0, "0.1 kg"))
"""The paper's first natural frequencies [Hz] and their payloads, marked in the spectra."""

CYCLE_TIMES = (1.0, 0.5, 0.25)
"""Cycle times of Fig. 10 [s]."""

BLEND_LENGTHS = (0.025, 0.0125, 0.006125)
"""Blend lengths d = e of Fig. 11 [m]; the last one as printed (half of 12.5 mm would be 6.25 mm)."""


def blends() -> Figure:
    """Fig. 6: the three blends of 25 mm overlaid, in the corner that they round."""
    drawing = draw(5.2, 4.6)
    axes = drawing.add_subplot()
    for curve, colour in zip(CURVES, COLOURS, strict=False):
        # axes along the crossing and the lift, the first corner as origin [mm]
        motion = plan(trajectory_scene(POLYNOMIAL, curve))
        path = motion.profiled.path
        lift = np.array(path.lift) / np.hypot(*path.lift)
        offset = _path(motion, PIECE) - MILLI * (np.array(path.start) + path.height * lift)
        crossing = np.abs(offset @ np.array([-lift[1], lift[0]]))
        near = crossing <= SHOWN
        axes.plot(crossing[near], (offset @ lift)[near], color=colour, label=curve)
    axes.plot([0.0, 0.0, SHOWN], [-25.0, 0.0, 0.0], color=GREY, linestyle=":", linewidth=1.2, label="sharp corner")
    axes.set(xlabel="along the crossing [mm]", ylabel="along the lift [mm]", aspect="equal")
    axes.set_title("Blends with d = e = 25 mm")
    axes.legend(loc="lower right")
    return drawing


def motion_profiles() -> Figure:
    """Fig. 7: fraction of the path, its rate and its second derivative for a cycle time of 1 s."""
    drawing = draw(6.4, 6.6)
    panels = drawing.subplots(3, 1, sharex=True)
    for label, colour in zip(PROFILES, COLOURS, strict=True):
        task = plan(trajectory_scene(label, "Lamé")).profiled
        # times (N,) [s] and fraction of the path with two derivatives (3, N), jumps with both their sides
        pieces = task.profile.pieces
        etas = [np.linspace(piece.start, piece.end, PIECE) for piece in pieces]
        jets = [piece.jet(eta, 2).rescale(1.0 / task.duration) for piece, eta in zip(pieces, etas, strict=True)]
        derivatives = np.concatenate([jet.derivatives() for jet in jets], axis=1)
        for panel, values in zip(panels, derivatives, strict=True):
            panel.plot(task.duration * np.concatenate(etas), values, color=colour, label=label)
    for panel, unit in zip(panels, ("position s", "velocity ds/dt [1/s]", "acceleration d²s/dt² [1/s²]"), strict=True):
        panel.set_ylabel(unit)
    panels[0].set_title("Motion profiles for a cycle time of 1 s")
    panels[0].legend(loc="upper left")
    panels[-1].set_xlabel("time [s]")
    return drawing


def joint_motion() -> Figure:
    """Fig. 8: joint angles and accelerations of the Lamé path for 1 s, and the spectra of all motion profiles."""
    drawing = draw(9.6, 7.0)
    # both joints above, spectra below
    grid = drawing.add_gridspec(2, 2)
    angle, acceleration = drawing.add_subplot(grid[0, 0]), drawing.add_subplot(grid[0, 1])
    joints = plan(trajectory_scene(POLYNOMIAL, "Lamé")).joints
    for joint, colour in zip((0, 1), COLOURS, strict=False):
        for piece, (time, derivatives) in enumerate(smooth_pieces(joints, PIECE)):
            label = f"joint {joint + 1}" if piece == 0 else None
            angle.plot(time, np.degrees(derivatives[0, :, joint]), color=colour, label=label)
            acceleration.plot(time, derivatives[2, :, joint], color=colour, label=label)
    angle.set(xlabel="time [s]", ylabel="joint angle [°]", title="Joint motion, polynomial, 1 s")
    acceleration.set(xlabel="time [s]", ylabel="joint acceleration [rad/s²]", title="Joint acceleration")
    angle.legend()
    acceleration.legend()
    # spectra of all motion profiles
    spectrum = drawing.add_subplot(grid[1, :])
    _draw_spectra(spectrum, {profile: trajectory_scene(profile, "Lamé") for profile in PROFILES})
    spectrum.set_title("Spectrum of the acceleration, the same for both joints since the path is symmetric")
    return drawing


def placement() -> Figure:
    """Fig. 9: the path in the workspace, with the mechanism at the start, the middle and the end of the motion."""
    drawing = draw(7.4, 6.6)
    axes = drawing.add_subplot()
    motion = plan(trajectory_scene(POLYNOMIAL, "Lamé"))
    # the workspace is where both legs reach, neither fully stretched nor folded
    mechanism = motion.scene.mechanism
    long = mechanism.proximal.length + mechanism.distal.length
    short, half = abs(mechanism.distal.length - mechanism.proximal.length), mechanism.base_half_distance
    x, y = np.meshgrid(*[np.linspace(-1.05 * long, 1.05 * long, 601)] * 2)
    distances = [np.hypot(x - base, y) for base in (-half, half)]
    margin = np.min([np.minimum(long - distance, distance - short) for distance in distances], axis=0)
    axes.contourf(MILLI * x, MILLI * y, margin, levels=[0.0, np.inf], colors=[PALE], alpha=0.6)
    axes.contour(MILLI * x, MILLI * y, margin, levels=[0.0], colors=[GREY], linewidths=1.2)
    axes.annotate("reached by both legs", (0.0, 480.0), ha="center", fontsize=8.5, color=GREY)
    _draw_robot(axes, motion)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", title="The path in the workspace")
    return drawing


def cycle_times() -> Figure:
    """Fig. 10: spectra for cycle times of 1, 0.5 and 0.25 s."""
    scenes = {f"{time:g} s": trajectory_scene(POLYNOMIAL, "Lamé", duration=time) for time in CYCLE_TIMES}
    return _spectra(scenes, "Cycle times: polynomial on the Lamé path, joint 1", "cycle time")


def blend_lengths() -> Figure:
    """Fig. 11: spectra for symmetric blends of 25, 12.5 and 6.125 mm."""
    scenes = {
        f"{MILLI * length:g} mm": trajectory_scene(
            POLYNOMIAL, "Lamé", blend={"kind": "lame", "height": length, "width": length}
        )
        for length in BLEND_LENGTHS
    }
    return _spectra(scenes, "Blend lengths: polynomial on the Lamé path, 1 s, joint 1", "d = e")


def path_errors(simulations: Mapping[PaperCase, SimulatedCase], tables: Sequence[PaperTable]) -> Figure:
    """Fig. 12: norm of the position error for the payload of 6 kg, one panel for each curve."""
    drawing = draw(7.6, 8.2)
    panels = drawing.subplots(3, 1, sharex=True, sharey=True)
    for panel, curve in zip(panels, CURVES, strict=True):
        _draw_errors(panel, simulations, curve)
        panel.set_title(curve)
    drawing.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(PROFILES))
    panels[-1].set_xlabel("time [s]")
    return drawing


def overview(simulations: Mapping[PaperCase, SimulatedCase], tables: Sequence[PaperTable]) -> Figure:
    """The overview for the README: robot and path, path error, printed and computed figures."""
    drawing = draw(11.0, 5.0)
    grid = drawing.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    # the robot at the left
    robot = drawing.add_subplot(grid[:, 0])
    _draw_robot(robot, plan(case_scene(TRAJECTORY_SCENE, POLYNOMIAL, "Lamé")))
    robot.set(xlabel="x [mm]", ylabel="y [mm]", title="The five-bar robot and its pick-and-place path", aspect="equal")
    robot.set(xlim=(-400.0, 400.0), ylim=(-85.0, 375.0))
    # path error above, with room for its legend
    errors = drawing.add_subplot(grid[0, 1])
    _draw_errors(errors, simulations, "Lamé")
    errors.set(xlabel="time [s]", title="What elasticity leaves: 6 kg in 0.43 s")
    errors.set_ylim(top=1.35 * errors.get_ylim()[1])
    errors.legend(loc="upper left", fontsize=8, ncols=2, handlelength=1.2, columnspacing=1.0)
    # computed over printed figures below, on equal axes with the line of agreement; a misprint is hollow
    axes = drawing.add_subplot(grid[1, 1])
    compared = {
        "peak_torque_1": ("torque [N m]", "o", 1.0),
        "rms_acceleration_error": ("RMS acceleration error [m/s²]", "s", 1.0),
        "peak_modal_deflection_1": ("deflection [µm]", "^", MILLI),
    }
    for (metric, (label, marker, scale)), colour in zip(compared.items(), COLOURS, strict=False):
        chosen = [table.quantity(metric) for table in tables if table.key in ("table-07", "table-09")]
        cells = [cell for quantity in chosen for cell in quantity.cells]
        points = scale * np.array([(float(cell.printed), cell.computed) for cell in cells])
        good = np.array([cell.believable for cell in cells])
        shared: dict[str, Any] = {"marker": marker, "linestyle": "", "markersize": 5}
        axes.loglog(*points[good].T, **shared, color=colour, label=label, alpha=0.8, markeredgewidth=0)
        axes.loglog(*points[~good].T, **shared, markerfacecolor="white", markeredgecolor=colour)
        for point in points[~good]:
            place: dict[str, Any] = {"xytext": (-8, -3), "textcoords": "offset points", "ha": "right"}
            axes.annotate("misprint", point, **place, fontsize=8, color=GREY)
    limits = np.array([2.0, 220.0])
    axes.plot(limits, limits, color=GREY, linewidth=1.0, zorder=1)
    axes.set(xlim=limits, ylim=limits, xlabel="printed in the paper", ylabel="computed through the FMU")
    axes.set_title("Tables 7 and 9: 72 figures", color=INK)
    axes.legend(loc="upper left", fontsize=8)
    return drawing


class PaperFigure(NamedTuple):
    """A figure of the report.

    Attributes:
        key: file name without suffix, for example ``figure-06``; the overview's stands in the report's folder itself.
        label, caption: for example ``Figure 6`` and one sentence.
    """

    key: str
    label: str
    caption: str

    def file(self, suffix: str = "") -> str:
        """Path of the figure's file within the report's folder; ``suffix`` is ``.png`` or ``.svg``."""
        return f"{self.key}{suffix}" if self.key == "overview" else f"figures/{self.key}{suffix}"


def _printed(number: int, caption: str) -> PaperFigure:
    return PaperFigure(f"figure-{number:02}", f"Figure {number}", caption)


TRAJECTORY_FIGURES: Mapping[PaperFigure, Callable[[], Figure]] = {
    _printed(6, "The three blends overlaid, d = e = 25 mm."): blends,
    _printed(7, "The motion profiles for a cycle time of 1 s."): motion_profiles,
    _printed(
        8,
        "Joint motion on the Lamé path with the seventh-degree polynomial in 1 s, and the power spectral density "
        "of the joint accelerations for all motion profiles (4 s window: motion, then standstill).",
    ): joint_motion,
    _printed(9, "The path, the mechanism at its start, middle and end, and the workspace."): placement,
    _printed(10, "Spectral content of the polynomial on the Lamé path for three cycle times."): cycle_times,
    _printed(11, "Spectral content of the same motion in 1 s for three lengths of the blends."): blend_lengths,
}
"""Figures that need no simulation → what draws them."""

SIMULATED_FIGURES: Mapping[PaperFigure, Callable[[Mapping[PaperCase, SimulatedCase], Sequence[PaperTable]], Figure]] = {
    _printed(
        12, "Path-tracking error of the end effector with the payload of 6 kg, over the motion of 0.43 s and the dwell."
    ): path_errors,
    PaperFigure(
        "overview",
        "Overview",
        "The flexible five-bar robot on its pick-and-place path, the error that its elasticity leaves, "
        "and the 72 figures of Tables 7 and 9 beside those computed through the FMU.",
    ): overview,
}
"""Figures of simulations and tables → what draws them."""


def _path(motion: MotionPlan, points: int) -> RealArray:
    """Points (N, 2) of the end effector's path [mm]."""
    return MILLI * np.concatenate([found[0] for _, found in smooth_pieces(motion.task, points, order=0)])


def _draw_robot(axes: Axes, motion: MotionPlan) -> None:
    """Draw the robot [mm] at the start, the middle and the end of the motion (paler from one to the next), and its path."""
    mechanism = motion.scene.mechanism
    positions = motion.task.evaluate(np.array([0.0, 0.5, 1.0]) * motion.duration, order=0)[0]
    hinges: dict[str, Any] = {"marker": "o", "markerfacecolor": "white", "markeredgecolor": INK, "markersize": 5}
    for (x, y), opacity in zip(positions.tolist(), (1.0, 0.35, 0.15), strict=True):
        for foot, knee in zip(bases(mechanism), elbows(mechanism, (x, y)), strict=True):
            leg = MILLI * np.array([foot, knee, (x, y)])
            axes.plot(*leg.T, color="#9aa7b4", linewidth=7.0, solid_capstyle="round", alpha=opacity, **hinges)
    for number, (x, _) in enumerate(bases(mechanism), start=1):
        axes.annotate(f"motor {number}", (MILLI * x, -30.0), ha="center", va="top", fontsize=8, color=INK)
    # path with start and end marked
    path = _path(motion, 201)
    axes.plot(path[:, 0], path[:, 1], color=COLOURS[1], linewidth=2.0, zorder=6)
    for point, text, marker in ((path[0], "start", "o"), (path[-1], "end", "s")):
        axes.plot(*point, marker, color=COLOURS[1], markersize=6, zorder=6)
        axes.annotate(text, point, xytext=(0, 8), textcoords="offset points", ha="center", fontsize=8, color=INK)


def _draw_errors(axes: Axes, simulations: Mapping[PaperCase, SimulatedCase], curve: str) -> None:
    """Draw the position error of every motion profile on one curve, with 6 kg."""
    for profile, colour in zip(PROFILES, COLOURS, strict=True):
        found = simulations[TRAJECTORY_SCENE, profile, curve]
        axes.plot(found.time, MILLI * found.path_error, color=colour, label=profile, linewidth=1.2)
    axes.set(ylabel="position error [mm]", xlim=(0.0, found.time[-1]))
    axes.set_ylim(bottom=0.0)
    mark_end(axes, found.duration)


def acceleration_spectrum(joints: Trajectory, joint: int) -> tuple[RealArray, RealArray]:
    """One-sided power spectral density of a joint's acceleration, and its frequencies.

    The signal is the motion followed by standstill, over a window of `WINDOW` seconds. It is zero at both ends of the
    window, so no taper is applied, and its mean is not removed. The integral of the density over the frequency is the
    mean square of the acceleration over the window. All motions share the window, so densities compare as energies.

    Args:
        joints: joint trajectory [rad].
        joint: 0 for q11, 1 for q21.

    Returns:
        Frequencies [Hz] in steps of 1 / `WINDOW`, and densities [(rad/s²)²/Hz].
    """
    time = np.arange(round(WINDOW * SAMPLING_FREQUENCY)) / SAMPLING_FREQUENCY
    acceleration = joints.evaluate(time, order=2)[2, :, joint]
    frequency, density = periodogram(acceleration, SAMPLING_FREQUENCY, window="boxcar", detrend=False)
    return frequency, density


def _spectra(scenes: Mapping[str, Scene], title: str, legend: str) -> Figure:
    drawing = draw(7.2, 4.4)
    axes = drawing.add_subplot()
    _draw_spectra(axes, scenes)
    axes.set_title(title)
    axes.legend(title=legend, loc="upper right")
    return drawing


def _draw_spectra(axes: Axes, scenes: Mapping[str, Scene]) -> None:
    """Draw the spectrum of joint 1 in each scene."""
    peak = 0.0
    for (label, scene), colour in zip(scenes.items(), COLOURS, strict=False):
        frequency, density = acceleration_spectrum(plan(scene).joints, 0)
        shown = (frequency > 0.0) & (frequency <= HIGHEST_FREQUENCY)
        axes.semilogy(frequency[shown], density[shown], color=colour, label=label, linewidth=1.0)
        peak = max(peak, float(density[shown].max()))
    axes.set_ylim(peak * 10.0**-DECADES, peak * 10.0)
    axes.set(xlabel="frequency [Hz]", ylabel="power spectral density [(rad/s²)²/Hz]", xlim=(0.0, HIGHEST_FREQUENCY))
    axes.legend(loc="upper right", ncols=2, fontsize=8)
    # the robot's first natural frequencies
    for first, payload in FIRST_FREQUENCIES:
        axes.axvline(first, color=GREY, linewidth=0.9, linestyle=(0, (4, 3)))
        place: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
        axes.annotate(f"f₁, {payload}", (first, 0.0), xytext=(3, 4), **place, fontsize=8, color=GREY)
