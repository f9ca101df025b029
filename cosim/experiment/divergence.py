"""Detects an unstable control loop from the recorded motion of a completed or failed run.

The joints' velocities are compared with the planned ones. A stable loop follows its references, or at least comes to rest with them.
The error of an unstable linear loop grows exponentially; its factor per sample is the largest magnitude of the loop's eigenvalues.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import hypot, log, sqrt
from typing import TYPE_CHECKING

import numpy as np

from flexfmu.cosim.engine.results import Column
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.recording import VELOCITIES

if TYPE_CHECKING:
    from flexfmu.cosim.experiment.scene_run import Run

BEYOND, BEYOND_BEFORE_FAILURE = 3.0, 1.0
"""Velocity error of a diverged run, for a completed and for a failed one, relative to the largest velocity of the planned
motion or of a fall."""

AT_REST, ON_THE_MOVE = 0.05, 0.5
"""Relative velocity error of an unstable loop during the dwell: for an error that grows (smaller ones may be stick-slip or
beats of undamped links), and for one that doesn't decay."""

GROWTH_AT_REST, LASTING = 1.3, 0.8
"""Smallest ratio of the errors in the last and the first third of the dwell: for an error that grows, and for one that
doesn't decay."""

ONSET, FULL = 0.01, 0.5
"""Shares of the bound between which the growth of the error is measured."""

ROUNDING = 1e-12
"""Relative difference within which two times are the same instant."""

FAST = 1.1
"""Growth per step from which the message gives it; of a slower one it gives the time to grow tenfold."""

SATURATED = 0.05
"""Share of instants at the largest value from which a torque is considered limited."""

INSTANTS = 500
"""Number of instants searched for the largest velocity of the planned motion."""


def divergence(run: Run, velocities: Sequence[Column | None] | None = None) -> str | None:
    """Message with the diverging signal, its growth and remedies; None for a stable loop.

    Args:
        run: the run; without a control loop there is no message.
        velocities: of both joints, at the run's instants; None for those of its recording. A joint without one isn't judged.
    """
    columns = [run.recording.columns.get(name) for name in VELOCITIES] if velocities is None else velocities
    known = {joint: each.values for joint, each in enumerate(columns) if each is not None}
    if run.scene.cosimulation.drive != "torque" or len(run.slaves) <= len(("trajectory", "plant")):
        return None
    if not known or run.recording.time.size < 2:
        return None
    time, joints = run.recording.time, run.plan.joints
    # most instants are there twice
    instants, places = np.unique(time, return_inverse=True)
    errors = np.stack([*known.values()], axis=1) - joints.evaluate(instants, 1)[1][places][:, [*known]]
    error = abs(errors).max(axis=1)
    peak = abs(joints.evaluate(np.linspace(0.0, joints.duration, INSTANTS), 1)[1]).max()
    # a robot may fall until its controller catches it
    fall = sqrt(hypot(*run.scene.effects.gravity) / run.scene.mechanism.proximal.length)
    scale = max(float(peak), fall)
    step, unit = _step(run)
    found = _growth_in_motion(time, error, step, scale * (BEYOND if run.completed else BEYOND_BEFORE_FAILURE))
    if found is None and run.completed:
        found = _growth_at_rest(time, error, step, run.plan.stop_time - run.scene.trajectory.dwell, scale)
    if found is None:
        return None
    factor, since = found
    worst = int(error.argmax())
    joint = 1 + [*known][int(abs(errors[worst]).argmax())]
    return (
        f"joint{joint}.velocity is up to {error[worst]:.3g} rad/s off its reference, where the motion needs {peak:.3g} rad/s; the error "
        f"{_growth_text(factor, unit, step)} from {since:.6g} s on: the control loop is unstable; {_remedies(run)}"
    )


def _growth_text(factor: float, unit: str, step: float) -> str:
    """How an error goes that changes by a factor in each step [s]."""
    if factor >= FAST:
        return f"grows {factor:.4g}-fold per {unit} of {step:g} s"
    return f"grows tenfold in {step * log(10.0) / log(factor):.3g} s" if factor > 1.0 + ROUNDING else "stays"


Growth = tuple[float, float]
"""Growth factor per step, and time at which the growth begins [s]."""


def _growth_in_motion(time: RealArray, error: RealArray, step: float, bound: float) -> Growth | None:
    """Growth of an error (N,) from the largest values in each step; None if it stays within the bound."""
    if not error.max() > bound:
        return None
    starts = np.flatnonzero(np.diff(np.floor(time / step * (1.0 + ROUNDING)), prepend=-1.0))
    sizes = np.maximum.reduceat(error, starts)
    first, last = (int(np.argmax(sizes >= share * bound)) for share in (ONSET, FULL))
    last = max(last, min(first + 1, sizes.size - 1))
    factor = (sizes[last] / sizes[first]) ** (1.0 / max(last - first, 1))
    return float(factor), float(time[starts[first]])


def _growth_at_rest(time: RealArray, error: RealArray, step: float, begin: float, scale: float) -> Growth | None:
    """Growth of an error (N,) that grows or doesn't decay during the dwell, from ``begin`` [s]; None if it does neither."""
    # largest error in each third of the dwell
    parts = [(time >= early) & (time <= late) for early, late in pairwise(np.linspace(begin, time[-1], 4))]
    if begin >= time[-1] or not all(part.any() for part in parts):
        return None
    first, middle, last = (float(error[part].max()) for part in parts)
    # it grows from third to third, or stays large
    grows = last > AT_REST * scale and last >= GROWTH_AT_REST * first and last >= middle >= first
    lasts = last > ON_THE_MOVE * scale and last >= LASTING * first
    if not (grows or lasts):
        return None
    # growth per step between the largest errors of the first and the last third
    early, late = (float(time[part][error[part].argmax()]) for part in (parts[0], parts[-1]))
    return (last / max(first, ROUNDING * last)) ** (step / (late - early)), early


def _step(run: Run) -> tuple[float, str]:
    """Shortest sample time, else the communication step [s], and its name."""
    samples = [slave.sample_time for slave in run.slaves if slave.sample_time]
    return (min(samples), "sample") if samples else (run.communication_step, "communication step")


def _remedies(run: Run) -> str:
    """Remedies, in one sentence."""

    def remedies() -> Iterator[str]:
        # general remedies, and delays longer than a step
        scene, latest = run.scene, max(run.delays, key=lambda delay: delay.average, default=None)
        yield "lower the gains, sample faster"
        if latest is not None and latest.average > _step(run)[0]:
            yield f"shorten the delays ({latest.average:.3g} s of {latest.connection})"
        if scene.cosimulation.integrator_step:
            yield f"make the fixed `cosimulation.integrator_step` of {scene.cosimulation.integrator_step:g} s smaller"
        if any(each.kind != "payload" for each in scene.disturbance):
            yield "make the disturbances smaller"
        # missing motor inertia
        if not scene.effects.motor_inertia:
            yield (
                "give the motors their inertia (`effects.motor_inertia`), without which velocity feedback acts on next to "
                "massless joints"
            )
        # limited torques
        for joint in (1, 2):
            torque = run.recording.columns.get(f"joint{joint}.torque")
            limit = 0.0 if torque is None else float(abs(torque.values).max())
            if torque is not None and limit and (abs(torque.values) > limit * (1.0 - ROUNDING)).mean() > SATURATED:
                yield f"raise the torque limit of {limit:.3g} N.m or protect integrators against windup"
                break

    *most, last = remedies()
    return f"{', '.join(most)}, or {last}" if most else last
