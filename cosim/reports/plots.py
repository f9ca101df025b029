"""Plots of a run's report: the mechanism on its path, joint references, torques, errors, deflections and residual vibration.

The report's picture of the scene: the path, and the rigid mechanism at start, middle and end of the motion.

The robot's motion with magnified deflections: points of the bent links over time, and the end effector's path.

A point is drawn at p_rigid + m (p - p_rigid): the rigid robot's, which follows its path exactly, at the same time, plus the deviation
from it, m times. Proximal links bend by the scene's shape functions with the recorded modal coordinates, and stretch evenly; distal
links bend about the straight line from elbow to end effector, the end effector being the recorded one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import floor, log10
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.motors import motor_loads
from flexfmu.cosim.metrics.segments import HermiteSegments
from flexfmu.cosim.metrics.signals import (
    JOINT_POSITIONS,
    POSITION,
    TIP_DEFLECTIONS,
    TORQUES,
    deviation_from_point,
    deviation_from_rigid,
    joint_error,
    position,
    position_rounding,
    sample,
    segments,
)
from flexfmu.cosim.reports.chart import DASHES, FIRST, GREY, INK, SECOND, Curve, Marker, Panel, packed
from flexfmu.cosim.reports.page import WIDTH, Plot
from flexfmu.cosim.reports.spectrum import spectrum, spectrum_caption, spectrum_panel
from flexfmu.cosim.reports.work_precision import tried_settings
from flexfmu.model.beams import Shape, scene_shapes, tip_force_bending
from flexfmu.model.scene.assembly import bases, elbows
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.curves import Point

FRAMES, DURATION = 401, 6.0
"""Largest number of instants of the animation, and how long it lasts [s]."""

STUDY_FRAMES, FEW_FRAMES = 121, 41
"""The same in a page about several runs, and in one that simulates, which has more from its own run."""

REFERENCES = ("joint1.reference.position", "joint2.reference.position")
"""Planned angles of the joints."""

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

    @property
    def extent(self) -> RealArray:
        """(2, 2) lowest and highest x and y of all drawn points at all instants [m].

        A robot that runs away leaves the axes where it is more than a proximal link's length beyond all rigid poses.
        """
        length = float(np.linalg.norm(self.rigid[0, self.links[0][-1]] - self.rigid[0, self.links[0][0]]))
        low, high = self.rigid.min(axis=(0, 1)) - length, self.rigid.max(axis=(0, 1)) + length
        drawn = np.clip(self.rigid + self.magnification * np.nan_to_num(self.deviation), low, high)
        return np.stack([drawn.min(axis=(0, 1)), drawn.max(axis=(0, 1))])

    def data(self) -> dict[str, Any]:
        """Return what the page's script animates."""
        styles = [("ink", 3.2), ("first", 2.2)] * 2
        chains = [
            {"points": points, "colour": colour, "width": width}
            for points, (colour, width) in zip(self.links, styles, strict=True)
        ]
        return {
            "count": self.rigid.shape[1],
            "instants": self.time.size,
            "chains": chains,
            "magnification": self.magnification,
            "slower": max(1.0, round(DURATION / float(self.time[-1] - self.time[0]), 1)),
            "points": packed(self.time, self.rigid, self.deviation),
        }


def rigid_motion(plan: MotionPlan) -> Recording:
    """What bends no link: the planned motion as a recording."""
    time = np.linspace(0.0, plan.duration, STUDY_FRAMES)
    values = dict(zip(POSITION, plan.task.evaluate(time, 0)[0].T, strict=True))
    values |= dict(zip(REFERENCES, plan.joints.evaluate(time, 0)[0].T, strict=True))
    return Recording(time, {name: Column("", each) for name, each in values.items()})


def bent_robot(plan: MotionPlan, recording: Recording, scene: Scene, most: int = FRAMES) -> BentRobot:
    """Return the robot in the last `LONGEST` seconds of a recording, at instants that are about equally spaced.

    Args:
        plan: the rigid robot's motion.
        recording: with at least two instants.
        scene: with the robot's own parameters.
        most: largest number of instants.
    """
    grid = np.linspace(recording.time[_shown(recording)][0], recording.time[-1], most)
    index = np.minimum(recording.time.searchsorted(grid), recording.time.size - 1)
    index = index[np.diff(index, prepend=-1) > 0]
    time, shapes = recording.time[index], scene_shapes(scene)
    end = np.stack([recording[name].values[index] for name in POSITION], axis=1)
    rigid_end = plan.task.evaluate(np.minimum(time, plan.duration), 0)[0]
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
        Curve(rigid[:, 0], rigid[:, 1], "rigid robot", GREY, is_read=False, source={"of": "rigid path"}),
        Curve(x, y, label=f"deviation × {magnification:g}", colour=FIRST, more=more, source={"of": "path"}),
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


PATH_POINTS = 400

POSES = ((0.0, 1.0), (0.5, 0.25), (1.0, 0.5))
"""Fractions of the duration at which the mechanism is drawn, each with its opacity."""


POSE = "pose"
"""Class of what is hidden while the mechanism moves."""


def scene_panel(plan: MotionPlan, robot: BentRobot) -> Panel:
    """Return the path and the mechanism, to scale [m], with room for all of the robot's motion.

    The poses are hidden where the page's script animates the robot.
    """
    plan = plan.once
    path = plan.task.evaluate(np.linspace(0.0, plan.duration, PATH_POINTS), 0)[0]
    path_curve = Curve(path[:, 0], path[:, 1], colour=SECOND, width=1.8, opacity=0.6, is_read=False)
    curves = [path_curve, Curve(robot.extent[:, 0], robot.extent[:, 1], width=0.0, is_read=False)]
    markers = [Marker(*_point(path[i]), text=text, offset=(6.0, -6.0)) for i, text in ((0, "start"), (-1, "end"))]
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
    return Panel(
        label="y [m]", curves=curves, markers=markers, is_to_scale=True, is_function=False, motion=robot.data()
    )


def _link(start: Point, end: Point, colour: str, width: float, opacity: float) -> Curve:
    x, y = np.array([start, end]).T
    return Curve(x, y, colour=colour, width=width, opacity=opacity, is_read=False, group=POSE)


def _point(position: RealArray) -> Point:
    return float(position[0]), float(position[1])


POINTS = 3000
"""Approximate number of points of a curve, as many as a plot of this size resolves."""

REFERENCES_HEIGHT = 380.0
"""Height of a plot [pt]."""

BESIDE, BESIDES, LEGEND = 58.0, 42.0, 22.0
"""Space beside and above or below the panel of a plot to scale, and for a legend, about [pt]."""

STRIP, USUAL_SHAPE = 0.4, 0.55
"""Height of a panel relative to its width below which it isn't to scale, also the other way round, and what it has then."""

COLOURS = (FIRST, SECOND)
"""Of the curves of joints and links 1 and 2."""


def draw_plots(run: Run, end_equilibrium: RealArray | None, frames: int = FRAMES) -> Iterator[Plot]:
    """Yield the plots for which the run has the signals, the scene first.

    Args:
        run: a run, complete or not.
        end_equilibrium: (2,) end effector in static equilibrium at the end pose [m]; None if unknown, which omits the dwell.
        frames: largest number of instants of the animation.
    """
    if run.accuracy is not None:
        yield from tried_settings(run.accuracy, run.plan.stop_time)
    # a run that ended at its start has no curves
    columns = run.recording.columns
    if np.count_nonzero(np.diff(run.recording.time) > 0.0) == 0:
        yield scene_plot(run.plan)
        return
    robot = bent_robot(run.plan, run.recording, run.robot, frames)
    yield scene_plot(run.plan, robot)
    last = f" in the last {LONGEST:g} s" if np.ptp(run.recording.time) > LONGEST else ""
    caption = f"Path of the end effector{last}; its deviation from the rigid robot × {robot.magnification:g}."
    yield _to_scale("path", "Path", caption, path_panel(run, robot.magnification))
    yield Plot("references", "Joint references", "What drives the robot.", _references(run), height=REFERENCES_HEIGHT)
    torques = _pair(run, TORQUES, "joint", "torque [N·m]", 1.0)
    yield Plot("torques", "Motor torques", "Positive counter-clockwise.", (torques,))
    yield from motor_plots(run)
    if all(name in columns for name in JOINT_POSITIONS):
        errors = [_curve(joint_error(run.recording, joint, run.plan.joints)) for joint in (0, 1)]
        drawn = [(time, 1e3 * values[:, 0]) for time, values in errors]
        panel = _both(run, "error [mrad]", "joint", drawn, [f"joint{joint}.error" for joint in (1, 2)], 1e3)
        yield Plot("tracking", "Tracking error", "Angle minus planned angle of each motor.", (panel,))
    if any(name in columns for name in TIP_DEFLECTIONS):
        caption = "Transverse displacement of the proximal links' tips."
        deflections = _pair(run, TIP_DEFLECTIONS, "link", "deflection [mm]", 1e3)
        yield Plot("deflections", "Tip deflections", caption, (deflections,))
    # errors against the rigid robot
    caption = "Distance of the end effector from the rigid robot's, which tracks its path exactly."
    deviation = deviation_from_rigid(position(run.recording), run.plan.task)
    yield Plot("position", "Position error", caption, (_norm(run, deviation, "error [mm]", 1e3, "deviation"),))
    caption = "Norm of the deviation from the rigid robot's acceleration."
    moving = deviation.within(0.0, run.plan.duration).resolving_curvature(position_rounding(run.recording))[0]
    yield Plot(
        "acceleration",
        "Acceleration error",
        caption,
        (_norm(run, moving, "error [m/s²]", 1.0, "acceleration", order=2),),
    )
    # the dwell, if the run reached it
    if end_equilibrium is not None and deviation.within(run.plan.duration, np.inf).start.size:
        vibration = deviation_from_point(position(run.recording), end_equilibrium).within(run.plan.duration, np.inf)
        caption = "Distance from the static equilibrium at the end pose during the dwell, and the settling band."
        limits = run.plan.duration, float(run.recording.time[-1])
        panel = _norm(run, vibration, "distance [µm]", 1e6, "vibration")
        panel = replace(panel, level=1e6 * run.scene.cosimulation.settling_band, limits=limits)
        yield Plot("dwell", "Residual vibration", caption, (panel,))
        # spectra of both components, with the natural frequencies
        time, values = _curve(vibration)
        found = [(spectrum(time, values[:, axis], run.plan.duration), axis) for axis in (0, 1)]
        curves = [
            Curve(each[0], 1e6 * each[1], name, COLOURS[axis], source={"of": f"spectrum {name}", "factor": 1e6})
            for each, axis in found
            if each is not None
            for name in "xy"[axis]
        ]
        frequencies = [] if run.rests is None else run.rests.frequencies(run.parameters).tolist()
        marks = [(frequency, f"{number}") for number, frequency in enumerate(frequencies, start=1)]
        panel = spectrum_panel("amplitude [µm]", curves, marks, limits[1] - limits[0])
        caption = spectrum_caption("Deviation of the end effector from the static equilibrium over the dwell")
        caption += " Dashed: natural frequencies, motors locked." if panel.marks else ""
        if panel.curves:
            yield Plot("spectrum", "Spectrum of the residual vibration", caption, (panel,), "frequency [Hz]")


def scene_plot(plan: MotionPlan, robot: BentRobot | None = None) -> Plot:
    """The mechanism at start, middle and end of its path, and in motion: as it was recorded, or rigid."""
    caption = "The rigid mechanism at start, middle and end of the path. With scripts it moves"
    caption += "." if robot is None else ", its deviation from the rigid robot magnified."
    robot = robot or bent_robot(plan, rigid_motion(plan), plan.scene)
    return _to_scale("scene", "Scene", caption, scene_panel(plan, robot))


def _to_scale(key: str, title: str, caption: str, panel: Panel) -> Plot:
    """Return a plot of a panel to scale [m], as high as that is; of one that would be a strip, with axes of their own scales."""
    x, y = (float(np.ptp(np.concatenate([getattr(curve, axis) for curve in panel.curves]))) for axis in "xy")
    beside = BESIDES + LEGEND * any(curve.label for curve in panel.curves)
    if x * STRIP <= y <= x / STRIP:
        return Plot(key, title, caption, (panel,), "x [m]", beside + (WIDTH - BESIDE) * y / x)
    panel, caption = replace(panel, is_to_scale=False), f"{caption} x and y have different scales."
    return Plot(key, title, caption, (panel,), "x [m]", beside + (WIDTH - BESIDE) * USUAL_SHAPE)


def _references(run: Run) -> tuple[Panel, ...]:
    """Return reference position, velocity and acceleration of both joints."""
    panels = []
    for kind, unit in (("position", "rad"), ("velocity", "rad/s"), ("acceleration", "rad/s²")):
        names = [f"joint{joint}.reference.{kind}" for joint in (1, 2)]
        values = [(run.recording.time, run.recording[name].values) for name in names]
        panels.append(_both(run, f"{kind}\n[{unit}]", "joint", values, names))
    # the mark at the end of the motion in the last alone
    return (*(replace(each, marks=()) for each in panels[:-1]), panels[-1])


def _pair(run: Run, names: tuple[str, ...], of: str, label: str, factor: float) -> Panel:
    """Return two signals of the same unit, interpolated between the communication points."""
    found = [_curve(segments(run.recording, [name])) if name in run.recording.columns else None for name in names]
    drawn = [None if each is None else (each[0], factor * each[1][:, 0]) for each in found]
    return _both(run, label, of, drawn, names, factor)


def _both(
    run: Run,
    label: str,
    of: str,
    found: Iterable[tuple[RealArray, RealArray] | None],
    names: Sequence[str],
    factor: float = 1.0,
) -> Panel:
    """Return the curves of joints or links 1 and 2, as far as they are known; they are signals of these names times a factor."""
    curves = [
        Curve(*each, f"{of} {number}", colour, source={"of": name, "factor": factor})
        for number, (each, colour, name) in enumerate(zip(found, COLOURS, names, strict=True), start=1)
        if each is not None
    ]
    return Panel(label=label, curves=curves, marks=_marks(run.recording.time, run))


def _norm(run: Run, signal: HermiteSegments, label: str, factor: float, of: str, order: int = 0) -> Panel:
    """Return the norm of a signal's time derivative of the given order."""
    time, values = _curve(signal, order)
    curve = Curve(time, factor * np.linalg.norm(values, axis=1), source={"of": of, "factor": factor})
    return Panel(label=label, curves=[curve], from_zero=True, marks=_marks(time, run))


def _curve(signal: HermiteSegments, order: int = 0) -> tuple[RealArray, RealArray]:
    """Return times (N,) [s] and values (N, m) of a signal's derivative, dense enough for a smooth curve."""
    return sample(signal, int(np.clip(POINTS // max(len(signal.start), 1), 2, 20)), order)


def _marks(time: RealArray, run: Run) -> list[tuple[float, str]]:
    """Return the mark at the end of the motion, if it lies between the times (N,) [s]."""
    end = run.plan.duration
    return [(end, "end of motion")] if time[0] < end < time[-1] else []


def motor_plots(run: Run) -> Iterator[Plot]:
    """Yield torque over speed of each motor with its limits, and power over time; nothing for a scene without motors."""
    loads = motor_loads(run)
    if not loads:
        return
    caption = "At the shaft, with the limits of the motor: peak torque and speed, and dashed the continuous torque."
    corners = np.array([[-1.0, 1.0, 1.0, -1.0, -1.0], [-1.0, -1.0, 1.0, 1.0, -1.0]])
    for load, colour in zip(loads, COLOURS, strict=True):
        motor = load.motor
        limits = [
            Curve(motor.maximum_speed * corners[0], torque * corners[1], name, GREY, dashes=dashes, is_read=False)
            for torque, name, dashes in (
                (motor.peak_torque, "peak torque, speed", ""),
                (motor.continuous_torque, "continuous torque", DASHES),
            )
        ]
        path = Curve(load.speed, load.torque, load.label, colour, more={"time [s]": load.time})
        panel = Panel(label="torque [N·m]", curves=[*limits, path], is_function=False)
        yield Plot(f"motor-{load.joint}", f"Torque over speed, {load.label}", caption, (panel,), "speed [rad/s]")
    curves = [Curve(load.time, load.power, load.label, colour) for load, colour in zip(loads, COLOURS, strict=True)]
    panel = Panel(label="power [W]", curves=curves)
    yield Plot("motor-power", "Mechanical power of the motors", "At the shaft; negative: regenerated.", (panel,))
