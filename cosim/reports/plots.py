"""Plots of a run's report: the mechanism on its path, joint references, torques, errors, deflections and residual vibration.

The report's picture of the scene: the path, and the rigid mechanism at start, middle and end of the motion.

The robot's motion with magnified deflections, of which the page's script draws the links: a point at p_rigid + m (p - p_rigid), the
rigid robot's, which follows its path exactly, at the same time, plus the deviation from it, m times. Proximal links bend by the scene's
shape functions with the recorded modal coordinates, and stretch evenly; distal links bend about the straight line from elbow to end
effector, the end effector being the recorded one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.motors import motor_loads
from flexfmu.cosim.metrics.signals import (
    JOINT_POSITIONS,
    POSITION,
    deviation_from_point,
    deviation_from_rigid,
    joint_error,
    position,
    position_rounding,
    sample,
    segments,
)
from flexfmu.cosim.reports.chart import DASHES, FIRST, GREY, INK, PALETTE, SECOND, Curve, Marker, Panel, look
from flexfmu.cosim.reports.page import Plot
from flexfmu.cosim.reports.spectrum import spectrum, spectrum_caption, spectrum_panel
from flexfmu.cosim.reports.work_precision import tried_settings
from flexfmu.model.beams import Shape, scene_shapes, tip_force_bending
from flexfmu.model.scene.assembly import bases, elbows, motor_angles
from flexfmu.model.scene.motor import Motor
from flexfmu.model.scene.schema import Scene

FRAMES, DURATION = 301, 6.0
"""Largest number of instants of the animation, and how long it lasts [s]."""

REFERENCES = ("joint1.reference.position", "joint2.reference.position")
"""Planned angles of the joints."""

LINKS = ((INK, 3.2), (FIRST, 2.2))
"""Colour and width of a leg's links, proximal and distal."""

VISIBLE = 0.1
"""Largest magnified deviation of the end effector relative to a proximal link's length, about."""


ROUNDING = 1e-9
"""Deviation relative to that length below which nothing is magnified."""


def rigid_motion(plan: MotionPlan) -> Recording:
    """What bends no link: the planned motion as a recording."""
    time = np.linspace(0.0, plan.duration, FRAMES)
    values = dict(zip(POSITION, plan.task.evaluate(time, 0)[0].T, strict=True))
    values |= dict(zip(REFERENCES, plan.joints.evaluate(time, 0)[0].T, strict=True))
    return Recording(time, {name: Column("", each) for name, each in values.items()})


def robot_motion(plan: MotionPlan, recording: Recording, scene: Scene) -> dict[str, Any]:
    """Return what the page's script bends and moves the robot by, ``Motion`` in page.js, of several cycles in the last.

    Its instants are about equally spaced.

    Args:
        plan: the rigid robot's motion.
        recording: with at least two instants.
        scene: with the robot's own parameters.
    """
    grid = np.linspace(recording.time[_shown(plan, recording)][0], recording.time[-1], FRAMES)
    index = np.minimum(recording.time.searchsorted(grid), recording.time.size - 1)
    index = index[np.diff(index, prepend=-1) > 0]
    time, rigid, deviation = _deviation(plan, recording, index)
    mechanism, shapes = scene.mechanism, scene_shapes(scene)
    rows, legs = [time, *rigid.T, *deviation.T], list[dict[str, Any]]()
    angles = np.array([motor_angles(mechanism, (x, y)) for x, y in rigid.tolist()]).T
    for leg, (base, rigid_angle, elbow) in enumerate(
        zip(bases(mechanism), angles, elbows(mechanism, tuple(rigid[0].tolist())), strict=True), start=1
    ):
        names = [f"joint{leg}.{kind}" for kind in ("position", "reference.position")]
        angle = [*[each for each in names if each in recording.columns][:1], f"joint{leg}.twist"]
        signals, matrices = [angle, [f"link{leg}1.elongation"]], list[Any]()
        own = shapes.get(("proximal", "bending"), ()), shapes.get(("distal", "bending"), ())
        for number, each in enumerate(own, start=1):
            bending, matrix = _bending(recording, f"link{leg}{number}", each)
            signals += [[name] for name in bending]
            matrices.append(matrix)
        signals = [[name for name in each if name in recording.columns] for each in signals]
        values = [sum((recording[name].values[index] for name in each), np.zeros(index.size)) for each in signals]
        values[0] = np.remainder(values[0] - rigid_angle + np.pi, 2.0 * np.pi) - np.pi
        rows += values
        (x, y), (dx, dy) = np.subtract(rigid[0], base), np.subtract(elbow, base)
        legs.append({"base": base, "side": np.sign(x * dy - y * dx), "shapes": matrices, "signals": signals})
    return {
        "legs": legs,
        "lengths": [mechanism.proximal.length, mechanism.distal.length],
        "links": LINKS,
        "magnification": magnification(deviation, mechanism.proximal.length),
        "slower": float(f"{DURATION / float(time[-1] - time[0]):.2g}"),
        "run": 0,
        "rows": rows,
    }


def _deviation(plan: MotionPlan, recording: Recording, index: Any) -> tuple[RealArray, RealArray, RealArray]:
    """Return instants (N,) [s] of a recording, the rigid robot's end effector then (N, 2) [m], and its deviation from that."""
    time = recording.time[index]
    rigid = plan.task.evaluate(np.minimum(time, plan.duration), 0)[0]
    return time, rigid, np.stack([recording[name].values[index] for name in POSITION], axis=1) - rigid


def magnification(deviation: RealArray, length: float) -> float:
    """Factor 1, 2 or 5 times a power of ten, at least 1, that makes deviations (F, 2) visible beside a proximal link's length [m]."""
    largest = float(np.nanmax(np.linalg.norm(deviation, axis=1), initial=0.0))
    if largest < ROUNDING * length:
        return 1.0
    round_numbers = np.outer(10.0 ** np.arange(10), [1.0, 2.0, 5.0])
    return float(round_numbers[round_numbers <= max(VISIBLE * length / largest, 1.0)].max())


def path_panel(run: Run, magnification: float) -> Panel:
    """Return the end effector's path, of several cycles in the last, beside the rigid robot's, its deviation magnified [m]."""
    time, rigid, deviation = _deviation(run.plan, run.recording, _shown(run.plan, run.recording))
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


def _shown(plan: MotionPlan, recording: Recording) -> slice:
    """Return the indices of all instants, of several cycles those from the last one's begin on."""
    length = np.inf if plan.repetition is None else plan.stop_time - plan.duration + plan.repetition.period
    return slice(int(recording.time.searchsorted(recording.time[-1] - length)), None)


def _bending(recording: Recording, link: str, shapes: tuple[Shape, ...]) -> tuple[list[str], list[list[float]]]:
    """Return the signals that bend a link, and what each displaces points along the link by (n, modes); n = 2 for one that stays straight."""
    names = [f"{link}.bending[{mode}]" for mode in range(1, len(shapes) + 1)]
    if not all(name in recording.columns for name in names):
        # the deflection of the tip alone, with the shape of a force there
        names, shapes = [f"{link}.tip_deflection"], (tip_force_bending(),)
    if not shapes or not all(name in recording.columns for name in names):
        return [], [[], []]
    xi = np.linspace(0.0, 1.0, 2 * len(shapes) + 3)
    return names, np.array([shape.value(xi) for shape in shapes]).T.tolist()


POSES = (1.0, 0.25, 0.5)
"""Opacities of the mechanism at start, middle and end of its path."""

POSE = "pose"
"""Class of what is hidden while the mechanism moves."""


def scene_panel(plan: MotionPlan, robot: Mapping[str, Any]) -> Panel:
    """Return the path and the mechanism, to scale [m].

    The poses are hidden where the page's script animates the robot.
    """
    once, mechanism = plan.once, plan.once.scene.mechanism
    path = once.task.evaluate(np.linspace(0.0, once.duration, FRAMES), 0)[0]
    curves = [Curve(path[:, 0], path[:, 1], "", SECOND, 1.8, 0.6, is_read=False)]
    ends = (("start", *path[0].tolist()), ("end", *path[-1].tolist()))
    markers = [Marker(x, y, text=text, offset=(6.0, -6.0)) for text, x, y in ends]
    # links as lines, elbows and end effector as discs, motors on top
    for number, opacity in enumerate(POSES):
        x, y = path[number * (FRAMES - 1) // (len(POSES) - 1)].tolist()
        for base, elbow in zip(bases(mechanism), elbows(mechanism, (x, y)), strict=True):
            for pair, (colour, thickness) in zip(((base, elbow), (elbow, (x, y))), LINKS, strict=True):
                link = np.array(pair)
                curves.append(Curve(link[:, 0], link[:, 1], "", colour, thickness, opacity, is_read=False, group=POSE))
            markers.append(Marker(elbow[0], elbow[1], 5.0, opacity=opacity, group=POSE))
        markers.append(Marker(x, y, 7.0, SECOND, max(opacity, 0.6), group=POSE))
    for leg, (x, y) in enumerate(bases(mechanism), start=1):
        below = Marker(x, y, text=f"motor {leg}", offset=(0.0, 14.0), anchor="middle")
        markers += [Marker(x, y, size=10.0, colour=GREY, shape="square"), below]
    return Panel("y [m]", curves, markers, is_to_scale=True, is_function=False, motion=robot)


POINTS = 3000
"""Approximate number of points of a curve, as many as a plot of this size resolves."""

STRIP = 0.4
"""Height of a panel relative to its width below which it isn't to scale, also the other way round."""

DISTANCES = ("deviation", "acceleration", "vibration")
"""Signals that are never negative."""

FRAME, EACH = 90.0, 100.0
"""Height of what is around the panels of a plot of signals, and of each [pt]."""


def _both(pattern: str, of: str = "joint") -> dict[str, str]:
    return {pattern.replace("#", number): f"{of} {number}" for number in "12"}


Shown = tuple[str, str, str, float, Mapping[str, Mapping[str, str]]]
"""Key, title and caption of a plot, factor from the SI unit, and label of each panel → signals with their names."""

# fmt: off
SIGNALS: Sequence[Shown] = (
    ("references", "Joint references", "What drives the robot.", 1.0,
     {f"{kind}\n[{unit}]": _both(f"joint#.reference.{kind}")
      for kind, unit in (("position", "rad"), ("velocity", "rad/s"), ("acceleration", "rad/s²"))}),
    ("torques", "Motor torques", "Positive counter-clockwise.", 1.0, {"torque [N·m]": _both("joint#.torque")}),
    ("tracking", "Tracking error", "Angle minus planned angle of each motor.", 1e3, {"error [mrad]": _both("joint#.error")}),
    ("deflections", "Tip deflections", "Transverse displacement of the proximal links' tips.", 1e3,
     {"deflection [mm]": _both("link#1.tip_deflection", "link")}),
    ("position", "Position error", "Distance of the end effector from the rigid robot's, which tracks its path exactly.", 1e3,
     {"error [mm]": {"deviation": ""}}),
    ("acceleration", "Acceleration error", "Norm of the deviation from the rigid robot's acceleration.", 1.0,
     {"error [m/s²]": {"acceleration": ""}}),
    ("dwell", "Residual vibration",
     "Distance from the static equilibrium at the end pose during the dwell, and the settling band.", 1e6,
     {"distance [µm]": {"vibration": ""}}),
    ("spectrum", "Spectrum of the residual vibration",
     spectrum_caption("Deviation of the end effector from the static equilibrium over the dwell"), 1e6,
     {"amplitude [µm]": {"spectrum x": "x", "spectrum y": "y"}}),
)
# fmt: on
"""The plots of a run, see `signal_values`."""


def draw_plots(run: Run, end_equilibrium: RealArray | None) -> Iterator[Plot]:
    """Yield the plots for which the run has the signals, the scene first.

    Args:
        run: a run, complete or not.
        end_equilibrium: (2,) end effector in static equilibrium at the end pose [m]; None if unknown, which omits the dwell.
    """
    if run.accuracy is not None:
        yield from tried_settings(run.accuracy, run.plan.stop_time)
    # a run that ended at its start has no curves
    if np.count_nonzero(np.diff(run.recording.time) > 0.0) == 0:
        yield scene_plot(run.plan)
        return
    robot = robot_motion(run.plan, run.recording, run.robot)
    yield scene_plot(run.plan, robot)
    last = " in the last cycle" if run.plan.repetition else ""
    caption = f"Path of the end effector{last}; its deviation from the rigid robot × {robot['magnification']:g}."
    yield to_scale("path", "Path", caption, path_panel(run, robot["magnification"]))
    end, stop = run.plan.duration, float(run.recording.time[-1])
    frequencies = [] if run.rests is None else run.rests.frequencies(run.parameters).tolist()
    found = signal_plots(
        SIGNALS, [""], lambda of: [signal_values(run, of, end_equilibrium)], end, stop - end, frequencies
    )
    for plot in found:
        if plot.key == "dwell":
            band = 1e6 * run.scene.cosimulation.settling_band
            plot = replace(plot, panels=(replace(plot.panels[0], level=band, limits=(end, stop)),))
        elif plot.key == "spectrum" and plot.panels[0].marks:
            plot = replace(plot, caption=f"{plot.caption} Dashed: natural frequencies, motors locked.")
        yield plot
        if plot.key == "torques":
            yield from motor_plots(run)


def signal_plots(
    groups: Sequence[Shown],
    runs: Sequence[str],
    values_of: Callable[[str], Sequence[tuple[RealArray, RealArray] | None]],
    end: float,
    window: float,
    frequencies: Sequence[float] = (),
) -> Iterator[Plot]:
    """Yield a plot for each group of signals of which one is there, or of their spectra.

    Args:
        groups: what there may be.
        runs: their names; of one without a name the curves have the names of signals.
        values_of: signal → of each run times and values, frequencies and amplitudes, or None.
        end: of the motion [s], which the first panel marks; NaN for none.
        window: time after it [s].
        frequencies: natural ones [Hz], which spectra mark.
    """
    natural = [(frequency, f"{number}") for number, frequency in enumerate(frequencies, start=1)]
    for key, title, caption, factor, rows in groups:
        panels, x_label = list[Panel](), "time [s]"
        for label, signals in rows.items():
            curves = [
                Curve(
                    x,
                    factor * y,
                    run or name,
                    source={"of": of, "factor": factor, "run": k},
                    **look(k if run else place),
                )
                for place, (of, name) in enumerate(signals.items())
                for k, (run, found) in enumerate(zip(runs, values_of(of), strict=True))
                if found is not None
                for x, y in [found]
            ]
            if all(of.startswith("spectrum") for of in signals):
                x_label, panel = "frequency [Hz]", spectrum_panel(label, curves, natural, window)
            else:
                is_passed = not panels and any(each.x[0] < end < each.x[-1] for each in curves)
                least = None if signals.keys().isdisjoint(DISTANCES) else 0.0
                panel = Panel(label, curves, least=least, marks=[(end, "end of motion")] if is_passed else ())
            panels += [panel] if panel.curves else []
        if panels:
            yield Plot(key, title, caption, tuple(panels), x_label, FRAME + EACH * len(panels))


def signal_values(run: Run, of: str, end_equilibrium: RealArray | None) -> tuple[RealArray, RealArray] | None:
    """Return times (N,) [s] and values (N,) of what a curve shows, interpolated densely enough for a smooth one.

    Args:
        run: the run.
        of: a recorded signal, or as ``Result.curve`` of simulation.js has it: the error of a joint; the deviation of the end effector
            from the rigid robot's or that of its acceleration, and its vibration about the equilibrium, of which an axis may follow, or
            the spectrum of that.
        end_equilibrium: as for `draw_plots`.

    Returns:
        None where it wasn't recorded.
    """
    recording, plan, order = run.recording, run.plan, 0
    if of.startswith("spectrum"):
        known = signal_values(run, of.replace("spectrum", "vibration"), end_equilibrium)
        return None if known is None else spectrum(*known, plan.duration)
    if of.endswith(".error"):
        joint = int(of[len("joint")]) - 1
        if JOINT_POSITIONS[joint] not in recording.columns:
            return None
        signal = joint_error(recording, joint, plan.joints)
    elif of == "deviation":
        signal = deviation_from_rigid(position(recording), plan.task)
    elif of == "acceleration":
        moving = deviation_from_rigid(position(recording), plan.task).within(0.0, plan.duration)
        signal, order = moving.resolving_curvature(position_rounding(recording))[0], 2
    elif of.startswith("vibration"):
        if end_equilibrium is None:
            return None
        signal = deviation_from_point(position(recording), end_equilibrium).within(plan.duration, np.inf)
    elif of in recording.columns:
        signal = segments(recording, [of])
    else:
        return None
    if not signal.start.size:
        return None
    time, values = sample(signal, int(np.clip(POINTS // signal.start.size, 2, 20)), order)
    if of[-2:] in (" x", " y"):
        return time, values[:, "xy".index(of[-1])]
    return time, values[:, 0] if values.shape[1] == 1 else np.linalg.norm(values, axis=1)


def scene_plot(plan: MotionPlan, robot: Mapping[str, Any] | None = None) -> Plot:
    """The mechanism at start, middle and end of its path, and in motion: as it was recorded, or rigid."""
    deviation = "." if robot is None else "; in motion its deviation from the rigid robot is magnified."
    caption = f"The mechanism on its path{deviation}"
    robot = robot or robot_motion(plan, rigid_motion(plan), plan.scene)
    return to_scale("scene", "Scene", caption, scene_panel(plan, robot))


def to_scale(key: str, title: str, caption: str, panel: Panel) -> Plot:
    """Return a plot of a panel to scale [m]; of one that would be a strip, with axes of their own scales."""
    along = (np.concatenate([getattr(curve, axis) for curve in panel.curves]) for axis in "xy")
    x, y = (float(np.nanmax(each) - np.nanmin(each)) for each in along)
    if not STRIP * x <= y <= x / STRIP:
        panel, caption = replace(panel, is_to_scale=False), f"{caption} x and y have different scales."
    return Plot(key, title, caption, (panel,), "x [m]")


def motor_plots(run: Run) -> Iterator[Plot]:
    """Yield torque over speed of each motor with its limits, and power over time; nothing for a scene without motors."""
    loads = motor_loads(run)
    if not loads:
        return
    caption = "At the shaft, with the limits of the motor: peak torque and speed, and dashed the continuous torque."

    def limit(motor: Motor, torque: float, name: str, dashes: tuple[float, ...] = ()) -> Curve:
        x, y = motor.maximum_speed * np.array([-1, 1, 1, -1, -1]), torque * np.array([-1, -1, 1, 1, -1])
        return Curve(x, y, name, GREY, dashes=dashes, is_read=False)

    for load, colour in zip(loads, PALETTE, strict=False):
        motor = load.motor
        limits = [
            limit(motor, motor.peak_torque, "peak torque, speed"),
            limit(motor, motor.continuous_torque, "continuous torque", DASHES),
        ]
        path = Curve(load.speed, load.torque, load.label, colour, more={"time [s]": load.time})
        panel = Panel(label="torque [N·m]", curves=[*limits, path], is_function=False)
        yield Plot(f"motor-{load.joint}", f"Torque over speed, {load.label}", caption, (panel,), "speed [rad/s]")
    curves = [Curve(load.time, load.power, load.label, colour) for load, colour in zip(loads, PALETTE, strict=False)]
    panel = Panel(label="power [W]", curves=curves)
    yield Plot("motor-power", "Mechanical power of the motors", "At the shaft; negative: regenerated.", (panel,))
