"""What a run's loop warns of: instability along its path, and encoders that are too coarse for the gains.

At rest a coarse encoder switches between two counts. Each switch is a step of the measured position, and for one difference a step
of the velocity, by the resolution over the window. The open loop's answer to it is a torque: of PD control kp q + kd q / (w h).
The margins don't see it, since roundings are left out of the linear loop; where it is a considerable part of the torques that
there are, the robot rattles. Source: R. C. Kavanagh and J. M. D. Murphy, "The effects of quantization noise and sensor nonideality
on digital differentiator-based rate measurement", IEEE Trans. Instrumentation and Measurement 47 (1998), pp. 1457-1463.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from math import ceil, inf, log, pi
from operator import mul
from typing import TypedDict

import numpy as np
from scipy.linalg import block_diag

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.design.margins.course import PathLoop, Place, worst_places
from flexfmu.cosim.design.margins.linear_loop import Continuous, LinearLoop
from flexfmu.cosim.design.margins.margins import critical_gain, gain_limits, gain_measures, growth, is_stable
from flexfmu.cosim.design.margins.scene_loop import WiredLoop
from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.scene_loop import Loop, loop_of
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.experiment.system import PLANT
from flexfmu.model.numeric import inverse_dynamics
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.errors import EquilibriumError, SceneError
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray

NEAR = 1.1
"""Factor of the torques, up or down, within which a loop must be stable to be far enough from instability."""

NOTICEABLE = 0.03
"""Relative difference from which a measure is noticeably worse."""

UNSTABLE = "the loop is unstable"
"""Begins the sentence on an unstable loop."""

FARTHEST, STEPS = 20.0, 25
"""Largest change of an unstable loop's torques that is tried, and number of changes."""

SHARE = 0.05
"""Share of the torque limit from which the torque of one count is worth a warning."""

SAMPLES = 20
"""Number of samples within which the torque of one count is largest, beside those that blocks remember."""

INSTANTS = 100
"""Number of instants searched for the largest torque that the motion needs."""

KINDS = ("encoder", "quantisation")
"""Kinds of imperfections that round."""

TORQUES = ("joint1.torque", "joint2.torque")

Step = tuple[int, int, float, str]
"""Index of a sampled block, of its input, the smallest step of that, and what it is."""

NOT_LINEAR = (CosimError, SceneError, TrajectoryError, EquilibriumError, ValueError)
"""Errors of loops that can't be linearised."""


class LoopSentences(TypedDict):
    """What `loop_sentences` returns."""

    stability: str | None
    coarse_counts: str | None
    stable: bool


def loop_sentences(run: Run) -> LoopSentences:
    """What there is to say of the stability of a run's loop, unless the run itself shows that it is unstable, and of its encoders;
    and whether it is stable, as far as that is known."""
    stability, counts, scene = None, None, run.scene
    if scene.controller and run.health.unstable_loop is None:
        stability = stability_warning(run)
    if scene.controller and any(each.kind in KINDS for each in scene.imperfection):
        with suppress(*NOT_LINEAR):
            counts = coarse_counts(scene, *_wired(run))
    stable = run.health.unstable_loop is None and not (stability or "").startswith(UNSTABLE)
    return {"stability": stability, "coarse_counts": counts, "stable": stable}


@one_blas_thread()
def stability_warning(run: Run) -> str | None:
    """What there is to say of a run's loop about standstill along its path; None for a loop that is far from instability everywhere,
    for none, and for one that can't be linearised."""
    try:
        _, wired = _wired(run)
        path = PathLoop(wired, run.plan, identify=False)
        breakpoints = path.breakpoints(run.scene)
        found = worst_places(lambda place: _worse(path, place), lambda each: each[1], breakpoints, (path.payload,))
    except NOT_LINEAR:
        return None
    # the end, where the robot stays, unless another place is noticeably worse
    end, worst = Place(1.0, path.payload), min(found, key=lambda place: min(found[place][1]))
    least, there = (min(found[place][1]) for place in (worst, end))
    if there - least <= NOTICEABLE * abs(least) and (there < 0.0) == (least < 0.0):
        worst = end
    where = f"about the pose at {100.0 * worst.s:.3g} % of the path" if worst.s < 1.0 else "about the end of the motion"
    return _sentence(found[worst][0], where)


def _wired(run: Run) -> tuple[Loop, WiredLoop]:
    """The loop of a run about rest, around its FMU."""
    loop = loop_of(run.scene, run.plan, about_rest=True)
    return loop, WiredLoop(run.scene, loop, FmuSlave(run.fmu_path, PLANT, {}, None))


def _worse(path: PathLoop, place: Place) -> tuple[LinearLoop, tuple[float, ...]]:
    """The loop at a place, the worse one of the ways there and back, and its measures."""

    def measures(loop: LinearLoop) -> tuple[float, ...]:
        if (rate := growth(loop).real) >= 0.0:
            return (-rate * float(loop.period),) * 2
        return gain_measures(*gain_limits(loop, FARTHEST))

    found = [(loop, measures(loop)) for loop, _ in path.loops(place)]
    return min(found, key=lambda each: min(each[1]))


def _sentence(loop: LinearLoop, where: str) -> str | None:
    """What there is to say of a loop: how fast it grows and the nearest torques with which it is stable, or how close it is."""
    if not is_stable(loop):
        pole, stable = growth(loop), ""
        at = f" at {abs(pole.imag) / (2.0 * pi):.3g} Hz" if abs(pole.imag) > 1e-9 * abs(pole) else ""
        time = log(10.0) / pole.real
        for factor in np.repeat(np.geomspace(1.0, FARTHEST, STEPS)[1:], 2) ** np.tile([-1.0, 1.0], STEPS - 1):
            if is_stable(loop, float(factor)):
                percent = 100.0 * abs(critical_gain(loop, float(factor)) - 1.0)
                stable = f", with torques {percent:.3g} % {'smaller' if factor < 1.0 else 'larger'} it is stable"
                break
        grows = f"small motions grow tenfold in {f'{1e3 * time:.3g} ms' if time < 1.0 else f'{time:.3g} s'}{at}"
        return f"{UNSTABLE} {where}: {grows}{stable}; see `flexfmu margins`"
    for factor, way in ((NEAR, "larger"), (1.0 / NEAR, "smaller")):
        if not is_stable(loop, factor):
            percent = 100.0 * abs(critical_gain(loop, factor) - 1.0)
            return f"the loop is close to instability {where}: with torques {percent:.2g} % {way} it is unstable; see `flexfmu margins`"
    return None


def coarse_counts(scene: Scene, loop: Loop, wired: WiredLoop) -> str | None:
    """A sentence on the largest torque of one count, about rest at both ends of the path; None below `SHARE` of the limits.

    Where a joint has no torque limit, the largest torque that the motion needs stands for it.

    Raises:
        InputError, ValueError, EquilibriumError: as for `WiredLoop.at`.
    """
    steps = [*_steps(wired)]
    if not steps:
        return None
    limits = _limits(wired, scene)
    needed = dict.fromkeys(TORQUES, inf) if limits.keys() >= {*TORQUES} else _needed(loop.motion)
    worst, message = SHARE, None
    task = loop.motion.once.task
    for x, y in task.evaluate([0.0, loop.motion.once.duration], 0)[0].tolist():
        linear, names = wired.at((x, y))
        for block, row, size, what in steps:
            for name, torque in zip(names, torque_of_step(linear, block, row, size).tolist(), strict=True):
                limit = limits.get(name, needed.get(name, inf))
                if torque > worst * limit:
                    worst = torque / limit
                    text = "the torque limit" if name in limits else "the largest torque that the motion needs"
                    message = (
                        f"{what} is {torque:.3g} N·m of {name}, {100.0 * worst:.0f} % of {text}, {limit:.3g} N·m: the robot may "
                        "rattle at rest; take a finer resolution, velocities over a longer window or through a filter, or lower gains"
                    )
    return message


def torque_of_step(loop: LinearLoop, block: int, row: int, size: float) -> RealArray:
    """The largest torque (channels,) [N.m] after a step of one input of a block, with a robot that doesn't move.

    Args:
        loop: the linear loop.
        block, row: index of the block, and of its input.
        size: of the step, in the input's unit.
    """
    # a constant state beside those of robot and lags is the step; the loop is cut at the robot
    x, n, signals = loop.continuous, len(loop.continuous.a), len(loop.continuous.c)

    def wider(pair: tuple[RealArray, RealArray]) -> tuple[RealArray, RealArray]:
        one, other = (np.vstack([each, np.zeros((1, each.shape[1]))]) for each in pair)
        return one, other

    constant = Continuous(
        block_diag(x.a, np.zeros((1, 1))), block_diag(x.c, np.ones((1, 1))), wider(x.held), wider(x.channels)
    )
    inputs = [np.insert(each, signals, 0.0, axis=1) for each in loop.inputs]
    inputs[block][row, signals] = size
    cut = replace(loop, continuous=constant, inputs=tuple(inputs)).lifted.part(range(len(loop.channels)))
    # period after period
    state, found = np.zeros(len(cut.a)), np.zeros(len(loop.channels))
    state[n] = 1.0
    samples = SAMPLES + sum(len(each.a) for each in loop.blocks)
    places = [i for i, _ in cut.times]
    for _ in range(ceil(samples * max(each.sample_time for each in loop.blocks) / float(loop.period))):
        np.maximum.at(found, places, abs(np.real(cut.c @ state)))
        state = np.real(cut.a @ state)
    return found


def _steps(wired: WiredLoop) -> Iterator[Step]:
    """The smallest steps of a loop's encoders and quantisers."""
    for k, i in enumerate(wired.sampled):
        slave = wired.system.slaves[i]
        if not isinstance(slave, BlockSlave):
            continue
        rows = [each.name for each in slave.block.inputs]
        for each in slave.block.parameters:
            channel, _, key = each.name.rpartition(".")
            value = each.start or 0.0
            if f"{channel}.input" not in rows or value <= 0.0:
                continue
            row = rows.index(f"{channel}.input")
            if key == "counts_per_turn":
                size = 2.0 * pi / value
                yield k, row, size, f"one count of {slave.name} ({1e3 * size:.3g} mrad, {value:g} counts per turn)"
            elif key == "resolution":
                yield k, row, value, f"one step of {slave.name} ({value:g} {slave.block.inputs[row].unit} of {channel})"


def _limits(wired: WiredLoop, scene: Scene) -> dict[str, float]:
    """Torque limit of each joint that has one [N.m]: of its motor, of saturations, and the largest one of its controllers."""
    motor, largest = scene.motor, dict[str, float]()
    found = {} if motor is None else dict(zip(TORQUES, map(mul, motor.peak_torque, motor.gear_ratio), strict=True))
    for slave in wired.system.slaves:
        if not isinstance(slave, BlockSlave):
            continue
        inputs = [each.name for each in slave.block.inputs]
        for each in slave.block.parameters:
            name, _, key = each.name.rpartition(".")
            if key not in ("minimum", "maximum") or name not in TORQUES or each.start is None:
                continue
            if f"{name}.input" in inputs:  # a saturation
                found[name] = min(found.get(name, inf), abs(each.start))
            else:
                largest[name] = max(largest.get(name, 0.0), abs(each.start))
    return {name: min(found.get(name, inf), largest.get(name, inf)) for name in {*found, *largest}}


def _needed(motion: MotionPlan) -> dict[str, float]:
    """Largest torque of each joint that the rigid robot needs for a motion [N.m]."""
    joints = motion.once.joints
    states = joints.evaluate(np.linspace(0.0, joints.duration, INSTANTS), 2)
    torques = np.asarray(inverse_dynamics(motion.scene).map(INSTANTS)(*(each.T for each in states)).full())
    return dict(zip(TORQUES, abs(torques).max(axis=1).tolist(), strict=True))
