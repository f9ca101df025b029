"""The robot's motion with magnified deflections: points of the bent links over time, and the end effector's path.

A point is drawn at p_rigid + m (p - p_rigid): the rigid robot's, which follows its path exactly, at the same time, plus the deviation
from it, m times. Proximal links bend by the scene's shape functions with the recorded modal coordinates, and stretch evenly; distal
links bend about the straight line from elbow to end effector, the end effector being the recorded one.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from math import floor, log10

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.prepared_scene import Run
from flexfmu.cosim.metrics.signals import POSITION
from flexfmu.cosim.reports.chart import Curve, Panel
from flexfmu.cosim.reports.curve_data import packed
from flexfmu.cosim.reports.svg import FIRST, GREY
from flexfmu.model.beams import Shape, tip_force_bending
from flexfmu.model.link_shapes import scene_shapes
from flexfmu.model.scene.assembly import bases, elbows

FRAMES, DURATION = 401, 6.0
"""Largest number of instants of the animation, and how long it lasts [s]."""

LONGEST = 1.2
"""Time before the end of a run that is shown [s]: of several cycles the last, in enough instants for its vibration."""

VISIBLE = 0.1
"""Largest magnified deviation of the end effector relative to a proximal link's length, about."""


ROUNDING = 1e-9
"""Deviation relative to that length below which nothing is magnified."""


@dataclass(frozen=True)
class BentRobot:
    """Points along the links of a robot at some instants of its motion.

    Attributes:
        time: (F,) instants of the recording [s].
        rigid: (F, P, 2) points of the rigid robot [m]; the last one is the end effector.
        deviation: (F, P, 2) deviations of the flexible robot's points from them [m].
        links: indices of the points of each link, from its beginning to its end: both of leg 1, then those of leg 2.
    """

    time: RealArray
    rigid: RealArray
    deviation: RealArray
    links: tuple[tuple[int, ...], ...]

    @cached_property
    def magnification(self) -> float:
        """Factor 1, 2 or 5 times a power of ten, at least 1, that makes deviations visible."""
        length = float(np.linalg.norm(self.rigid[0, self.links[0][-1]] - self.rigid[0, self.links[0][0]]))
        largest = float(np.nanmax(np.linalg.norm(self.deviation[:, -1], axis=1), initial=0.0))
        if largest < ROUNDING * length:
            return 1.0
        wanted = VISIBLE * length / largest
        power = 10.0 ** floor(log10(wanted)) if wanted > 1.0 else 1.0
        return power * max(factor for factor in (1.0, 2.0, 5.0) if factor * power <= max(wanted, 1.0))

    def data(self) -> dict[str, str]:
        """Return what the page's script animates, as attributes of a panel."""
        styles = [("ink", 3.2), ("first", 2.2)] * 2
        chains = [
            {"points": points, "colour": colour, "width": width}
            for points, (colour, width) in zip(self.links, styles, strict=True)
        ]
        span = float(self.time[-1] - self.time[0])
        motion = {
            "count": self.rigid.shape[1],
            "instants": self.time.size,
            "chains": chains,
            "magnification": self.magnification,
            "slower": max(1.0, round(DURATION / span, 1)),
        }
        return {"motion": json.dumps(motion), "points": packed(self.time, self.rigid, self.deviation)}


def bent_robot(run: Run, most: int = FRAMES) -> BentRobot:
    """Return the robot of a run in its last `LONGEST` seconds, at recorded instants that are about equally spaced.

    Args:
        run: a run with at least two instants.
        most: largest number of instants.
    """
    recording, scene = run.recording, run.robot
    grid = np.linspace(recording.time[_shown(recording)][0], recording.time[-1], most)
    index = np.minimum(recording.time.searchsorted(grid), recording.time.size - 1)
    index = index[np.diff(index, prepend=-1) > 0]
    time, shapes = recording.time[index], scene_shapes(scene)
    end = np.stack([recording[name].values[index] for name in POSITION], axis=1)
    rigid_end = run.plan.task.evaluate(np.minimum(time, run.plan.duration), 0)[0]
    rigid_elbows = np.array([elbows(scene.mechanism, (x, y)) for x, y in rigid_end.tolist()])
    # leg by leg: base to elbow, and what lies between elbow and end effector
    rigid, bent, links, count = list[RealArray](), list[RealArray](), list[list[int]](), 0
    for leg, base in enumerate(bases(scene.mechanism), start=1):
        origin = np.broadcast_to(np.array(base), end.shape)
        proximal = _bending(recording, index, f"link{leg}1", shapes.get(("proximal", "bending"), ()))
        distal = _bending(recording, index, f"link{leg}2", shapes.get(("distal", "bending"), ()))
        angle = _values(recording, index, f"joint{leg}.position", f"joint{leg}.reference.position")
        angle = angle + _values(recording, index, f"joint{leg}.twist")
        length = scene.mechanism.proximal.length + _values(recording, index, f"link{leg}1.elongation")
        along = length[:, np.newaxis] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        bent_link = _points(origin, origin + along, proximal)
        elbow = rigid_elbows[:, leg - 1]
        rigid += [_points(origin, elbow, 0.0 * proximal), _points(elbow, rigid_end, 0.0 * distal)[:, 1:-1]]
        bent += [bent_link, _points(bent_link[:, -1], end, distal)[:, 1:-1]]
        first, second = proximal.shape[1], distal.shape[1] - 2
        links += [list(range(count, count + first)), list(range(count + first - 1, count + first + second))]
        count += first + second
    links[1].append(count)
    links[3].append(count)
    fixed = np.concatenate([*rigid, rigid_end[:, np.newaxis]], axis=1)
    moved = np.concatenate([*bent, end[:, np.newaxis]], axis=1)
    return BentRobot(time, fixed, moved - fixed, tuple(map(tuple, links)))


def path_panel(run: Run, magnification: float) -> Panel:
    """Return the end effector's path in the last `LONGEST` seconds beside the rigid robot's, its deviation magnified [m]."""
    recording, shown = run.recording, _shown(run.recording)
    time = recording.time[shown]
    rigid = run.plan.task.evaluate(np.minimum(time, run.plan.duration), 0)[0]
    deviation = np.stack([recording[name].values[shown] for name in POSITION], axis=1) - rigid
    x, y = (rigid + magnification * deviation).T
    more = {
        "time [s]": time,
        "deviation in x [µm]": 1e6 * deviation[:, 0],
        "deviation in y [µm]": 1e6 * deviation[:, 1],
    }
    curves = [
        Curve(rigid[:, 0], rigid[:, 1], "rigid robot", GREY, is_read=False),
        Curve(x, y, label=f"deviation × {magnification:g}", colour=FIRST, more=more),
    ]
    return Panel(label="y [m]", curves=curves, is_to_scale=True, is_function=False)


def _shown(recording: Recording) -> slice:
    """Return the indices of the last `LONGEST` seconds."""
    return slice(int(recording.time.searchsorted(recording.time[-1] - LONGEST)), None)


def _bending(recording: Recording, index: NDArray[np.intp], link: str, shapes: tuple[Shape, ...]) -> RealArray:
    """Return the displacement of points along a link normal to it (F, n) [m], n = 2 for a link that stays straight."""
    names = [f"{link}.bending[{mode}]" for mode in range(1, len(shapes) + 1)]
    if not all(name in recording.columns for name in names):
        # the deflection of the tip alone, with the shape of a force there
        names, shapes = [f"{link}.tip_deflection"], (tip_force_bending(),)
    if not shapes or not all(name in recording.columns for name in names):
        return np.zeros((index.size, 2))
    xi = np.linspace(0.0, 1.0, 2 * len(shapes) + 3)
    coordinates = np.stack([recording[name].values[index] for name in names], axis=1)
    return np.asarray(coordinates @ np.array([shape.value(xi) for shape in shapes]))


def _points(start: RealArray, end: RealArray, normal: RealArray) -> RealArray:
    """Return points (F, n, 2) from start to end (F, 2), displaced to the left by ``normal`` (F, n)."""
    along = end - start
    unit = along / np.linalg.norm(along, axis=1, keepdims=True)
    left = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    xi = np.linspace(0.0, 1.0, normal.shape[1])[:, np.newaxis]
    return np.asarray(start[:, np.newaxis] + xi * along[:, np.newaxis] + normal[:, :, np.newaxis] * left[:, np.newaxis])


def _values(recording: Recording, index: NDArray[np.intp], *names: str) -> RealArray:
    """Return the values of the first of the signals that was recorded, zeros where none was."""
    found = next((name for name in names if name in recording.columns), None)
    return np.zeros(index.size) if found is None else recording[found].values[index]
