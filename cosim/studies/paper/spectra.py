"""Spectra of the joint accelerations, and their figures (Figs. 8, 10 and 11).

A motion excites the links at the frequencies that its acceleration contains. The spectrum is the periodogram of the acceleration
over a window that all motions share (Oppenheim and Schafer, Discrete-Time Signal Processing, ch. 10), without a taper, since the
signal is zero at both ends.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.signal import periodogram

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.reports.figure_style import GREY, draw
from flexfmu.cosim.studies.paper.computed import smooth_pieces, trajectory_scene
from flexfmu.cosim.studies.paper.figures import POLYNOMIAL, PROFILE_COLOURS, SEQUENCE
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.trajectory import Trajectory

SAMPLING_FREQUENCY = 20_000.0
"""Sampling frequency [Hz], 100 times the highest one shown, so that aliasing of jumps stays below 1e-4."""

WINDOW = 4.0
"""Length of the window [s]: the motion, then standstill; the same for all motions, so that densities compare."""


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
    frequency, density = periodogram(
        acceleration, SAMPLING_FREQUENCY, window="boxcar", detrend=False, scaling="density"
    )
    return frequency, density


def band_average(frequency: RealArray, density: RealArray, width: float) -> RealArray:
    """Mean of the density over a band of ``width`` [Hz] around each frequency; narrower at the ends.

    A motion with jumps has a comb of lobes 1 / duration apart; the mean over several lobes is the excitation of a resonance
    whose frequency isn't known to a fraction of a hertz.
    """
    half = max(1, round(0.5 * width / (frequency[1] - frequency[0])))
    total = np.concatenate([[0.0], np.cumsum(density)])
    index = np.arange(density.size)
    first, last = np.maximum(index - half, 0), np.minimum(index + half + 1, density.size)
    return np.asarray((total[last] - total[first]) / (last - first))


HIGHEST_FREQUENCY = 200.0
"""Frequencies shown [Hz]: beyond the first natural frequency of the robot with the light payload."""

BAND = 5.0
"""Width of the bands over which the comb of a profile with jumps is averaged [Hz]: a few of its lobes."""

DECADES = 10.0
"""Decades of the density shown below its maximum."""

FIRST_FREQUENCIES = ((58.0, "6 kg"), (126.0, "0.1 kg"))
"""The paper's first natural frequencies [Hz] and their payloads, marked in the spectra."""

CYCLE_TIMES = (1.0, 0.5, 0.25)
"""Cycle times of Fig. 10 [s]."""

BLEND_LENGTHS = (0.025, 0.0125, 0.006125)
"""Blend lengths d = e of Fig. 11 [m]; the last one as printed (half of 12.5 mm would be 6.25 mm)."""


def joint_motion() -> Figure:
    """Fig. 8: joint angles and accelerations of the Lamé path for 1 s, and the spectra of all motion profiles."""
    drawing = draw(9.6, 7.0)
    # both joints above, spectra below
    grid = drawing.add_gridspec(2, 2)
    angle, acceleration = drawing.add_subplot(grid[0, 0]), drawing.add_subplot(grid[0, 1])
    spectrum = drawing.add_subplot(grid[1, :])
    joints = plan(trajectory_scene(POLYNOMIAL, "Lamé")).joints
    for joint, colour in zip((0, 1), SEQUENCE, strict=False):
        for piece, (time, derivatives) in enumerate(smooth_pieces(joints, 401)):
            label = f"joint {joint + 1}" if piece == 0 else None
            angle.plot(time, np.degrees(derivatives[0, :, joint]), color=colour, label=label)
            acceleration.plot(time, derivatives[2, :, joint], color=colour, label=label)
    angle.set(xlabel="time [s]", ylabel="joint angle [°]", title="Joint motion, polynomial, 1 s")
    acceleration.set(xlabel="time [s]", ylabel="joint acceleration [rad/s²]", title="Joint acceleration")
    angle.legend()
    acceleration.legend()
    # spectra of all motion profiles
    scenes = [(profile, trajectory_scene(profile, "Lamé"), colour) for profile, colour in PROFILE_COLOURS.items()]
    _spectra(spectrum, scenes, joint=0, band=BAND)
    spectrum.set_title("Spectrum of the acceleration, the same for both joints since the path is symmetric")
    return drawing


def cycle_times() -> Figure:
    """Fig. 10: spectra for cycle times of 1, 0.5 and 0.25 s."""
    scenes = [
        (f"{time:g} s", trajectory_scene(POLYNOMIAL, "Lamé").replace({"trajectory.duration": time}), colour)
        for time, colour in zip(CYCLE_TIMES, SEQUENCE, strict=True)
    ]
    return _one_panel(scenes, "Cycle times: polynomial on the Lamé path, joint 1", "cycle time")


def blend_lengths() -> Figure:
    """Fig. 11: spectra for symmetric blends of 25, 12.5 and 6.125 mm."""
    scenes = [
        (
            f"{1e3 * length:g} mm",
            trajectory_scene(POLYNOMIAL, "Lamé").replace(
                {"trajectory.blend": {"kind": "lame", "height": length, "width": length}}
            ),
            colour,
        )
        for length, colour in zip(BLEND_LENGTHS, SEQUENCE, strict=True)
    ]
    return _one_panel(scenes, "Blend lengths: polynomial on the Lamé path, 1 s, joint 1", "d = e")


def _one_panel(scenes: Iterable[tuple[str, Scene, str]], title: str, legend: str) -> Figure:
    drawing = draw(7.2, 4.4)
    axes = drawing.add_subplot()
    _spectra(axes, scenes, joint=0)
    axes.set_title(title)
    axes.legend(title=legend, loc="upper right")
    return drawing


def _spectra(axes: Axes, scenes: Iterable[tuple[str, Scene, str]], *, joint: int, band: float = 0.0) -> None:
    """Draw the spectrum of each scene; with a ``band`` [Hz] its mean over that band, and itself in a pale colour."""
    peak = 0.0
    for label, scene, colour in scenes:
        frequency, density = acceleration_spectrum(plan(scene).joints, joint)
        shown = (frequency > 0.0) & (frequency <= HIGHEST_FREQUENCY)
        line = density
        if band:
            axes.semilogy(frequency[shown], density[shown], color=colour, linewidth=0.4, alpha=0.3)
            line = band_average(frequency, density, band)
        axes.semilogy(frequency[shown], line[shown], color=colour, label=label, linewidth=1.3)
        peak = max(peak, float(density[shown].max()))
    axes.set_ylim(peak * 10.0**-DECADES, peak * 10.0)
    axes.set(xlabel="frequency [Hz]", ylabel="power spectral density [(rad/s²)²/Hz]", xlim=(0.0, HIGHEST_FREQUENCY))
    axes.legend(loc="upper right", ncols=2, fontsize=8)
    # the robot's first natural frequencies
    for first, payload in FIRST_FREQUENCIES:
        axes.axvline(first, color=GREY, linewidth=0.9, linestyle=(0, (4, 3)))
        axes.annotate(
            f"f₁, {payload}",
            (first, 0.0),
            xycoords=("data", "axes fraction"),
            xytext=(3, 4),
            textcoords="offset points",
            fontsize=8,
            color=GREY,
        )
