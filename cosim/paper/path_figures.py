"""Figures of the paths and profiles: blends (Fig. 6), motion profiles (Fig. 7), placement in the workspace (Fig. 9)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray

from flexfmu.cosim.paper.cases import trajectory_scene
from flexfmu.cosim.paper.colours import CURVE_COLOURS, PROFILE_COLOURS
from flexfmu.cosim.paper.mechanism import MILLI, draw_bases, draw_mechanism, draw_path, draw_workspace
from flexfmu.cosim.paper.motions import smooth_pieces
from flexfmu.cosim.planning import plan
from flexfmu.cosim.reports.figure_style import GREY, draw
from flexfmu.trajectories.profiles import Profile

POLYNOMIAL = "7th order polynomial"

SHOWN = 28.0
"""Part of the crossing shown beside the corner [mm]."""

PIECE = 401
"""Points drawn between two breakpoints."""

Points = NDArray[np.float64]


def blends() -> Drawing:
    """Fig. 6: the three blends of 25 mm overlaid, in the corner that they round."""
    drawing = draw(5.2, 4.6)
    axes = drawing.add_subplot()
    for curve, colour in CURVE_COLOURS.items():
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


def motion_profiles() -> Drawing:
    """Fig. 7: fraction of the path, its rate and its second derivative for a cycle time of 1 s."""
    drawing = draw(6.4, 6.6)
    panels = drawing.subplots(3, 1, sharex=True)
    for label, colour in PROFILE_COLOURS.items():
        task = plan(trajectory_scene(label, "Lamé")).along_path
        time, derivatives = _profile(task.profile, task.duration)
        for panel, values in zip(panels, derivatives, strict=True):
            panel.plot(time, values, color=colour, label=label)
    for panel, unit in zip(panels, ("position s", "velocity ds/dt [1/s]", "acceleration d²s/dt² [1/s²]"), strict=True):
        panel.set_ylabel(unit)
    panels[0].set_title("Motion profiles for a cycle time of 1 s")
    panels[0].legend(loc="upper left")
    panels[-1].set_xlabel("time [s]")
    return drawing


def _profile(profile: Profile, duration: float) -> tuple[Points, Points]:
    """Times (N,) [s], and the fraction of the path with two derivatives (3, N), jumps with both their sides."""
    etas = [np.linspace(piece.start, piece.end, PIECE) for piece in profile.pieces]
    jets = [piece.jet(eta, 2).rescale(1.0 / duration) for piece, eta in zip(profile.pieces, etas, strict=True)]
    return duration * np.concatenate(etas), np.concatenate([jet.derivatives() for jet in jets], axis=1)


def _corner(curve: str) -> tuple[Points, Points]:
    """The path around its first corner, which is the origin: along the crossing and along the lift [mm]."""
    motion = plan(trajectory_scene(POLYNOMIAL, curve))
    section = motion.scene.trajectory
    lift = np.array(section.lift) / np.hypot(*section.lift)
    path = np.concatenate([derivatives[0] for _, derivatives in smooth_pieces(motion.task, PIECE, order=0)])
    offset = MILLI * (path - np.array(section.start) - section.height * lift)
    crossing = np.abs(offset @ np.array([-lift[1], lift[0]]))
    near = crossing <= SHOWN
    return crossing[near], (offset @ lift)[near]


def placement() -> Drawing:
    """Fig. 9: the path in the workspace, with the mechanism at the start, the middle and the end of the motion."""
    drawing = draw(7.4, 6.6)
    axes = drawing.add_subplot()
    motion = plan(trajectory_scene(POLYNOMIAL, "Lamé"))
    draw_workspace(axes, motion)
    for time, opacity in ((0.0, 1.0), (0.5 * motion.duration, 0.35), (motion.duration, 0.15)):
        draw_mechanism(axes, motion, time, opacity=opacity)
    draw_bases(axes, motion)
    draw_path(axes, motion)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", title="The path in the workspace")
    axes.annotate("reached by both legs", (0.0, 480.0), ha="center", fontsize=8.5, color=GREY)
    return drawing
