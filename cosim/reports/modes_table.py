"""Natural frequencies along a scene's path, as data and as a table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.showing import Rows, few_lines
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.reports.chart import PALETTE, Curve, Panel, scale_of
from flexfmu.cosim.reports.page import Plot
from flexfmu.cosim.reports.terminal import titled_table
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.trajectories.jets import Jet
from flexfmu.trajectories.trajectory import positions_along

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN_FREQUENCIES = 6
"""Largest number of frequency columns in the table; the JSON has all frequencies."""


@dataclass(frozen=True)
class ModalPose:
    """The robot at one point of its path, motors locked.

    Attributes:
        s: fraction of the path's length, 0..1.
        x, y: rigid end-effector position [m].
        q11, q21: motor angles [rad], continuous along the path.
        frequencies: undamped natural frequencies about the static equilibrium [Hz], ascending; none for a rigid robot.
    """

    s: float
    x: float
    y: float
    q11: float
    q21: float
    frequencies: tuple[float, ...]


class ModesAlongPath(Rows, list[ModalPose]):
    """The robot's frequencies along its path: a list of poses that is also a table and a diagram.

    Args:
        name: of the scene.
        poses: from start to end of the path.
    """

    row_name = "s"

    def __init__(self, name: str = "", poses: Iterable[ModalPose] = ()) -> None:
        super().__init__(poses)
        self.name = name

    def __repr__(self) -> str:
        """Return at most five lines: the range of each frequency."""
        items = [
            f"f{k} {min(each):.4g} to {max(each):.4g} Hz"
            for k, each in enumerate(zip(*(pose.frequencies for pose in self), strict=True), start=1)
        ]
        return few_lines(f"Natural frequencies of {self.name} at {len(self)} poses, motors locked:", items)

    def rows(self) -> list[dict[str, Any]]:
        """A row for each pose, in m, rad and Hz."""
        return [
            {name: getattr(pose, name) for name in UNITS}
            | {f"f{k}": frequency for k, frequency in enumerate(pose.frequencies, start=1)}
            for pose in self
        ]

    def row_units(self) -> Mapping[str, str]:
        """Column → unit."""
        return UNITS | {f"f{k + 1}": "Hz" for k in range(len(self[0].frequencies) if self else 0)}

    def plot(self) -> Figure:
        """The lowest frequencies over the path."""
        from flexfmu.cosim.reports.figure_style import figure_of  # slower to load than the frequencies

        path = np.array([pose.s for pose in self])
        shown = np.array([pose.frequencies[:SHOWN_FREQUENCIES] for pose in self], ndmin=2)
        curves = [
            Curve(path, each, f"f{k}", colour, dot="disc")
            for k, (each, colour) in enumerate(zip(shown.T, PALETTE, strict=False), start=1)
        ]
        scale = scale_of(shown)
        panel = Panel("natural frequency [Hz]", curves, least=None if scale else 0.0, logarithmic=scale)
        title = f"{self.name}: natural frequencies, motors locked"
        return figure_of([Plot("modes", title, "", (panel,), "share of the path")])


UNITS = {"s": "", "x": "m", "y": "m", "q11": "rad", "q21": "rad"}
"""Column of a pose → unit."""


@one_blas_thread()
def modes_along_path(
    plan: MotionPlan, count: int, progress: Callable[[float], None] = lambda fraction: None
) -> ModesAlongPath:
    """Return the robot's frequencies at ``count`` poses, equally spaced by arc length from start to end of the path.

    Args:
        plan: the planned motion of a scene.
        count: number of poses, odd, at least 3.
        progress: called with the finished fraction, 0 to 1.

    Raises:
        InputError: ``count`` is even or below 3.
        EquilibriumError: the robot has no stable static equilibrium at a pose.
    """
    from flexfmu.model.statics import natural_frequencies

    if count < 3 or count % 2 == 0:
        raise InputError(
            f"the number of poses must be odd and at least 3, so that the middle of the path is one; got {count}"
        )
    # rigid poses along the path with unwrapped joint angles, and the robot's frequencies at each
    poses, fractions = [], np.linspace(0.0, 1.0, count)
    positions = positions_along(plan.along_path, fractions)
    angles = [joint.value for joint in plan.kinematics.joints(*(Jet(each[np.newaxis]) for each in positions.T))]
    joints = np.unwrap(np.stack(angles, axis=-1), axis=0)
    for s, (x, y), (q11, q21) in zip(fractions.tolist(), positions.tolist(), joints.tolist(), strict=True):
        frequencies = tuple(float(f) for f in natural_frequencies(plan.scene, (q11, q21)))
        poses.append(ModalPose(s, x, y, q11, q21, frequencies))
        progress(len(poses) / count)
    return ModesAlongPath(plan.scene.name, poses)


def modes_table(name: str, poses: list[ModalPose]) -> list[RenderableType]:
    """Return the frequencies as a table for the terminal, with a note if it doesn't show all of them."""
    total = len(poses[0].frequencies)
    shown = min(total, SHOWN_FREQUENCIES)
    headings = "path", "x [m]", "y [m]", *(f"f{k}" for k in range(1, shown + 1))
    table = titled_table(
        f"{name}: natural frequencies [Hz], motors locked, about the static equilibrium", numbers=headings
    )
    for pose in poses:
        # four decimals without a negative zero
        place = (f"{round(value, 4) + 0.0:.4f}" for value in (pose.x, pose.y))
        table.add_row(f"{pose.s:.3f}", *place, *(f"{f:.2f}" for f in pose.frequencies[:shown]))
    # what the table leaves out
    notes = []
    if total == 0:
        notes = ["All links are rigid: there are no natural frequencies."]
    elif total > shown:
        notes = [f"The lowest {shown} of {total}; --json prints all of them."]
    return [table, *(Text(note, style="italic") for note in notes)]
