"""The paper's figures: blends (Fig. 6), motion profiles (7), joint motion and its spectrum (8), placement in the workspace (9),
spectra over cycle times (10) and blend lengths (11), path-tracking error (12), and a picture that sums the experiment up.

A motion excites the links at the frequencies that its acceleration contains. Its spectrum is the periodogram of the acceleration
over a window that all motions share (Oppenheim and Schafer, Discrete-Time Signal Processing, ch. 10), without a taper, since the
signal is zero at both ends.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.signal import periodogram

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.reports.chart import GREY, PALETTE, Curve, Panel
from flexfmu.cosim.reports.figure_style import COLOURS, PALE, draw, draw_panel, figure_of
from flexfmu.cosim.reports.page import Plot
from flexfmu.cosim.reports.plots import scene_panel
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
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.trajectory import Trajectory

MILLI = 1e3
"""Factor from m to mm, the unit of drawings."""

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
    curves = list[Curve]()
    for curve, colour in zip(CURVES, PALETTE, strict=False):
        # axes along the crossing and the lift, the first corner as origin [mm]
        motion = plan(trajectory_scene(POLYNOMIAL, curve))
        path = motion.profiled.path
        lift = np.array(path.lift) / np.hypot(*path.lift)
        points = np.concatenate([found[0] for _, found in smooth_pieces(motion.task, PIECE, order=0)])
        offset = MILLI * (points - np.array(path.start) - path.height * lift)
        crossing = np.abs(offset @ np.array([-lift[1], lift[0]]))
        near = crossing <= SHOWN
        curves.append(Curve(crossing[near], (offset @ lift)[near], curve, colour))
    curves.append(
        Curve(np.array([0.0, 0.0, SHOWN]), np.array([-25.0, 0.0, 0.0]), "sharp corner", GREY, dashes=(1.0, 2.0))
    )
    panel = Panel("along the lift [mm]", curves, is_to_scale=True, is_function=False)
    return figure_of([Plot("blends", "Blends with d = e = 25 mm", "", (panel,), "along the crossing [mm]", 330.0)])


def motion_profiles() -> Figure:
    """Fig. 7: fraction of the path, its rate and its second derivative for a cycle time of 1 s."""
    labels = ("position s", "velocity ds/dt\n[1/s]", "acceleration d²s/dt²\n[1/s²]")
    shown = {label: list[Curve]() for label in labels}
    for label, colour in zip(PROFILES, PALETTE, strict=False):
        task = plan(trajectory_scene(label, "Lamé")).profiled
        # times (N,) [s] and fraction of the path with two derivatives (3, N), jumps with both their sides
        pieces = task.profile.pieces
        etas = [np.linspace(piece.start, piece.end, PIECE) for piece in pieces]
        jets = [piece.jet(eta, 2).rescale(1.0 / task.duration) for piece, eta in zip(pieces, etas, strict=True)]
        derivatives = np.concatenate([jet.derivatives() for jet in jets], axis=1)
        for curves, values in zip(shown.values(), derivatives, strict=True):
            curves.append(Curve(task.duration * np.concatenate(etas), values, label, colour))
    panels = tuple(Panel(label, curves) for label, curves in shown.items())
    return figure_of([Plot("profiles", "Motion profiles for a cycle time of 1 s", "", panels, height=420.0)])


def joint_motion() -> Figure:
    """Fig. 8: joint angles and accelerations of the Lamé path for 1 s, and the spectra of all motion profiles."""
    pieces = [*smooth_pieces(plan(trajectory_scene(POLYNOMIAL, "Lamé")).joints, PIECE)]
    time, values = np.concatenate([each for each, _ in pieces]), np.concatenate([each for _, each in pieces], axis=1)
    angles, accelerations = (
        [
            Curve(time, each, f"joint {joint}", colour)
            for joint, (each, colour) in enumerate(zip(rows.T, PALETTE, strict=False), 1)
        ]
        for rows in (np.degrees(values[0]), values[2])
    )
    panels = Panel("joint angle [°]", angles), Panel("joint acceleration\n[rad/s²]", accelerations)
    title = "Spectrum of the acceleration, the same for both joints"
    spectra = _spectra({profile: trajectory_scene(profile, "Lamé") for profile in PROFILES}, title)
    return figure_of([Plot("joints", "Joint motion, polynomial, 1 s", "", panels, height=300.0), spectra])


def placement() -> Figure:
    """Fig. 9: the path in the workspace, with the mechanism at the start, the middle and the end of the motion."""
    motion = plan(trajectory_scene(POLYNOMIAL, "Lamé"))
    drawing = figure_of(
        [Plot("placement", "The path in the workspace", "", (scene_panel(motion, {}),), "x [m]", 440.0)]
    )
    # the workspace is where both legs reach, neither fully stretched nor folded
    (axes,), mechanism = drawing.axes, motion.scene.mechanism
    long = mechanism.proximal.length + mechanism.distal.length
    short, half = abs(mechanism.distal.length - mechanism.proximal.length), mechanism.base_half_distance
    x, y = np.meshgrid(*[np.linspace(-1.05 * long, 1.05 * long, 201)] * 2)
    distances = [np.hypot(x - base, y) for base in (-half, half)]
    margin = np.min([np.minimum(long - distance, distance - short) for distance in distances], axis=0)
    axes.contourf(x, y, margin, levels=[0.0, np.inf], colors=[PALE], alpha=0.6)
    axes.contour(x, y, margin, levels=[0.0], colors=[COLOURS[GREY]], linewidths=1.2)
    axes.annotate("reached by both legs", (0.0, 0.48), ha="center", fontsize=8.5, color=COLOURS[GREY])
    return drawing


def cycle_times() -> Figure:
    """Fig. 10: spectra for cycle times of 1, 0.5 and 0.25 s."""
    scenes = {f"{time:g} s": trajectory_scene(POLYNOMIAL, "Lamé", duration=time) for time in CYCLE_TIMES}
    return figure_of([_spectra(scenes, "Cycle times: polynomial on the Lamé path, joint 1")])


def blend_lengths() -> Figure:
    """Fig. 11: spectra for symmetric blends of 25, 12.5 and 6.125 mm."""
    scenes = {
        f"d = e = {MILLI * length:g} mm": trajectory_scene(
            POLYNOMIAL, "Lamé", blend={"kind": "lame", "height": length, "width": length}
        )
        for length in BLEND_LENGTHS
    }
    return figure_of([_spectra(scenes, "Blend lengths: polynomial on the Lamé path, 1 s, joint 1")])


def path_errors(simulations: Mapping[PaperCase, SimulatedCase], tables: Sequence[PaperTable]) -> Figure:
    """Fig. 12: norm of the position error for the payload of 6 kg, one panel for each curve."""
    panels = tuple(_errors(simulations, curve, f"{curve}\nposition error [mm]") for curve in CURVES)
    drawing = figure_of([Plot("errors", "Position errors with 6 kg", "", panels, height=500.0)])
    highest = max(axes.get_ylim()[1] for axes in drawing.axes)
    for axes in drawing.axes:
        axes.set_ylim(0.0, highest)
    return drawing


def overview(simulations: Mapping[PaperCase, SimulatedCase], tables: Sequence[PaperTable]) -> Figure:
    """The overview for the README: robot and path, path error, printed and computed figures."""
    drawing = draw(11.0, 5.0)
    grid = drawing.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    robot, errors, axes = (drawing.add_subplot(grid[place]) for place in ((slice(None), 0), (0, 1), (1, 1)))
    # the robot at the left, the path error above at the right
    draw_panel(robot, scene_panel(plan(case_scene(TRAJECTORY_SCENE, POLYNOMIAL, "Lamé")), {}), "x [m]")
    robot.set(title="The five-bar robot and its pick-and-place path", xlim=(-0.4, 0.4), ylim=(-0.085, 0.375))
    draw_panel(errors, _errors(simulations, "Lamé", "position error [mm]"), "time [s]")
    errors.set_title("What elasticity leaves: 6 kg in 0.43 s")
    errors.set_ylim(top=1.35 * errors.get_ylim()[1])
    errors.legend(loc="upper left", fontsize=8, ncols=2, handlelength=1.2, columnspacing=1.0)
    # computed over printed figures below, with the line of agreement
    compared = {
        "peak_torque_1": ("torque [N m]", 1.0),
        "rms_acceleration_error": ("RMS acceleration error [m/s²]", 1.0),
        "peak_modal_deflection_1": ("deflection [µm]", MILLI),
    }
    limits = np.array([2.0, 220.0])
    curves = [Curve(limits, limits, "", GREY, 1.0)]
    for (metric, (label, scale)), colour in zip(compared.items(), PALETTE, strict=False):
        chosen = [table.quantity(metric) for table in tables if table.key in ("table-07", "table-09")]
        cells = [cell for quantity in chosen for cell in quantity.cells]
        printed, computed = scale * np.array([(float(cell.printed), cell.computed) for cell in cells]).T
        good = np.array([cell.believable for cell in cells])
        curves.append(Curve(printed[good], computed[good], label, colour, 0.0, dot="disc"))
        if not good.all():
            curves.append(Curve(printed[~good], computed[~good], "misprint", colour, 0.0, dot="cross"))
    panel = Panel("computed through the FMU", curves, limits=(2.0, 220.0), logarithmic="xy", is_function=False)
    draw_panel(axes, panel, "printed in the paper")
    axes.set_title("Tables 7 and 9: 72 figures")
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


def _errors(simulations: Mapping[PaperCase, SimulatedCase], curve: str, label: str) -> Panel:
    """The position error of every motion profile on one curve, with 6 kg."""
    found = {profile: simulations[TRAJECTORY_SCENE, profile, curve] for profile in PROFILES}
    curves = [
        Curve(each.time, MILLI * each.path_error, profile, colour, 1.2)
        for (profile, each), colour in zip(found.items(), PALETTE, strict=False)
    ]
    return Panel(label, curves, least=0.0, marks=[(found[POLYNOMIAL].duration, "end of motion")])


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


def _spectra(scenes: Mapping[str, Scene], title: str) -> Plot:
    """The spectrum of joint 1 in each scene, and the robot's first natural frequencies."""
    curves = list[Curve]()
    for (label, scene), colour in zip(scenes.items(), PALETTE, strict=False):
        frequency, density = acceleration_spectrum(plan(scene).joints, 0)
        shown = (frequency > 0.0) & (frequency <= HIGHEST_FREQUENCY)
        curves.append(Curve(frequency[shown], density[shown], label, colour, 1.0))
    least = max(float(each.y.max()) for each in curves) * 10.0**-DECADES
    marks = [(first, f"f₁, {payload}") for first, payload in FIRST_FREQUENCIES]
    panel = Panel(
        "power spectral density\n[(rad/s²)²/Hz]",
        curves,
        limits=(0.0, HIGHEST_FREQUENCY),
        least=least,
        logarithmic="y",
        marks=marks,
    )
    return Plot("spectra", title, "", (panel,), "frequency [Hz]", 280.0)
