"""A warning for runs whose loop is unstable, or nearly."""

from __future__ import annotations

from math import log, pi

import numpy as np

from flexfmu.cosim.design.margins.course import Course, Place, worst_places
from flexfmu.cosim.design.margins.linear_loop import LinearLoop
from flexfmu.cosim.design.margins.margins import critical_gain, gain_limits, gain_measures, growth, is_stable
from flexfmu.cosim.design.margins.scene_loop import WiredLoop
from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.experiment.system import PLANT
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.errors import EquilibriumError, SceneError
from flexfmu.trajectories.errors import TrajectoryError

NEAR = 1.1
"""Factor of the torques, up or down, within which a loop must be stable to be far enough from instability."""


NOTICEABLE = 0.03
"""Relative difference from which a measure is noticeably worse."""

FARTHEST, STEPS = 20.0, 25
"""Largest change of an unstable loop's torques that is tried, and number of changes."""


@one_blas_thread()
def stability_warning(run: Run) -> str | None:
    """What there is to say of a run's loop about standstill along its path; None for a loop that is far from instability everywhere,
    for none, and for one that can't be linearised."""
    scene = run.scene
    if scene.cosimulation.drive != "torque" or not scene.controller:
        return None
    try:
        loop = loop_of(scene, run.plan, about_rest=True)
        course = Course(WiredLoop(scene, loop, FmuSlave(run.fmu_path, PLANT, {}, None)), run.plan, identify=False)
        found = worst_places(
            lambda place: _worse(course, place), lambda each: each[1], course.breakpoints(scene), (course.payload,)
        )
    except (CosimError, SceneError, TrajectoryError, EquilibriumError, ValueError):
        return None
    # the end, where the robot stays, unless another place is noticeably worse
    end, worst = Place(1.0, course.payload), min(found, key=lambda place: min(found[place][1]))
    least, there = (min(found[place][1]) for place in (worst, end))
    if there - least <= NOTICEABLE * abs(least) and (there < 0.0) == (least < 0.0):
        worst = end
    where = f"about the pose at {100.0 * worst.s:.3g} % of the path" if worst.s < 1.0 else "about the end of the motion"
    return _sentence(found[worst][0], where)


def _worse(course: Course, place: Place) -> tuple[LinearLoop, tuple[float, ...]]:
    """The loop at a place, the worse one of the ways there and back, and its measures."""

    def measures(loop: LinearLoop) -> tuple[float, ...]:
        if (rate := growth(loop).real) >= 0.0:
            return (-rate * float(loop.period),) * 2
        return gain_measures(*gain_limits(loop, FARTHEST))

    found = [(loop, measures(loop)) for loop, _ in course.loops(place)]
    return min(found, key=lambda each: min(each[1]))


def _sentence(loop: LinearLoop, where: str) -> str | None:
    if not is_stable(loop):
        return f"the loop is unstable {where}: {_grows(loop)}{_stable_with(loop)}; see `flexfmu margins`"
    for factor, way in ((NEAR, "larger"), (1.0 / NEAR, "smaller")):
        if not is_stable(loop, factor):
            percent = 100.0 * abs(critical_gain(loop, factor) - 1.0)
            return f"the loop is close to instability {where}: with torques {percent:.2g} % {way} it is unstable; see `flexfmu margins`"
    return None


def _grows(loop: LinearLoop) -> str:
    """How fast small motions grow."""
    pole = growth(loop)
    at = f" at {abs(pole.imag) / (2.0 * pi):.3g} Hz" if abs(pole.imag) > 1e-9 * abs(pole) else ""
    return f"small motions grow tenfold in {1e3 * log(10.0) / pole.real:.3g} ms{at}"


def _stable_with(loop: LinearLoop) -> str:
    """Torques with which it is stable, the nearest ones up to a factor of 20."""
    for factor in np.geomspace(1.0, FARTHEST, STEPS)[1:].tolist():
        for tried, way in ((1.0 / factor, "smaller"), (factor, "larger")):
            if is_stable(loop, tried):
                percent = 100.0 * abs(critical_gain(loop, tried) - 1.0)
                return f", with torques {percent:.3g} % {way} it is stable"
    return ""
