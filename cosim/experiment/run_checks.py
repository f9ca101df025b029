"""What a run is checked for: the size of its recording before it starts, and an unstable control loop, from its recorded motion.

A duration in milliseconds where seconds are meant fills memory and disk. What is too large is refused, with the likely mistake.

For stability the joints' velocities are compared with the planned ones. A stable loop follows its references, or at least comes to rest with them.
The error of an unstable linear loop grows exponentially; its factor per sample is the largest magnitude of the loop's eigenvalues.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import hypot, inf, log, sqrt

import numpy as np

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.results import Column, Selection
from flexfmu.cosim.engine.slave import GivesOutputDerivatives, RealArray, Sampled
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.recording import VELOCITIES
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.experiment.system import SceneSystem
from flexfmu.cosim.experiment.wiring import names_of

LARGEST_SIZE = 2e9
"""Bytes of the recordings of a run and of its companion together that are made without being asked for."""

BYTES_PER_VALUE = 8.0

LONG, SHORT = 5.0, 1e-5
"""Time [s] from which it may be meant in milliseconds, and communication step [s] up to which it may be too."""


def recorded_bytes(parts: SceneSystem, selection: Selection, stop: float, step: float) -> float:
    """Return the bytes that a recording takes, from the points that the communication step and sample times make.

    Args:
        parts: the slaves.
        selection: what is recorded, by the names of the master.
        stop, step: end of the run and communication step [s].
    """
    clocks = {each.sample_time for each in parts.slaves if isinstance(each, Sampled) and each.sample_time < inf}
    # an instant at which signals jump is recorded twice
    instants = stop / (selection.step or step) + sum(2.0 * stop / each for each in clocks)
    values = 1.0
    for slave in parts.slaves:
        order = min(selection.order, slave.max_output_order) if isinstance(slave, GivesOutputDerivatives) else 0
        names = (f"{slave.name}.{name}" for name in names_of(slave, "output"))
        values += (1 + order) * sum(map(selection.keeps, names))
    return BYTES_PER_VALUE * values * instants


def check_size(motion: MotionPlan, parts: SceneSystem, sizes: Sequence[float], step: float) -> None:
    """Refuse what is too large to be recorded without being asked for.

    Args:
        motion: the planned motion.
        parts: the slaves.
        sizes: bytes of the recordings of the run and of its companion.
        step: communication step [s].

    Raises:
        InputError: the recordings have more than `LARGEST_SIZE` together; the message names sizes, duration and likely mistakes.
    """
    total = sum(sizes)
    if total <= LARGEST_SIZE:
        return
    largest = " and ".join(
        f"{1e-9 * each:.2g} GB{name}" for each, name in zip(sizes, ("", " for its companion"), strict=False)
    )
    hints = "".join(f"; {each}" for each in _unit_hints(motion, parts, step))
    raise InputError(
        f"{motion.scene.name}: {motion.stop_time:g} s in steps of {step:g} s record about {largest}, "
        f"more than {1e-9 * LARGEST_SIZE:g} GB{hints}; take a larger step, record less (`cosimulation.record`, `record_step`), or run it "
        f"all the same: `flexfmu run --yes`, in Python accept_size=True"
    )


def _unit_hints(motion: MotionPlan, parts: SceneSystem, step: float) -> Iterator[str]:
    """Yield what may be meant in another unit, of the times that make a recording large."""
    section = motion.scene.trajectory
    for key in ("duration", "dwell", "pause"):
        value = getattr(section, key, 0.0)
        if value >= LONG and value > 0.1 * motion.stop_time / getattr(section, "cycles", 1):
            yield f"`trajectory.{key}` = {value:g} s: {1e-3 * value:g} s? Times are in s, 1 ms is 1e-3 s"
    times = {"the communication step": step}
    times |= {f"the sample time of {each.name}": each.sample_time for each in parts.slaves if isinstance(each, Sampled)}
    for what, value in times.items():
        if value <= SHORT:
            yield f"{what} is {value:g} s: {1e3 * value:g} s? Times are in s, 1 ms is 1e-3 s"


def check_step(step: float, duration: float) -> None:
    """Check that a communication step [s] is not longer than the motion [s].

    Raises:
        InputError: it is.
    """
    if step > duration:
        raise InputError(
            f"the communication step of {step:g} s is longer than the motion of {duration:g} s: reduce "
            f"`cosimulation.step` (--step), to {duration / 1000:.1g} s for example"
        )


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
    time, joints, peak = run.recording.time, run.plan.joints, run.plan.top_speed
    scale, rest = usual_speed(run), run.plan.stop_time - run.scene.trajectory.dwell
    step, unit = _step(run)
    measured = np.stack([*known.values()], axis=1)
    # most joints are too slow to be that far off, and come to rest: their references needn't be evaluated
    speed = abs(measured).max(axis=1)
    is_slow = run.completed and joints.duration <= run.plan.duration and speed.max() <= 0.5 * BEYOND * scale
    if is_slow and _growth_at_rest(time, speed, step, rest, scale) is None:
        return None
    # most instants are there twice
    instants, places = np.unique(time, return_inverse=True)
    errors = measured - joints.evaluate(instants, 1)[1][places][:, [*known]]
    error = abs(errors).max(axis=1)
    found = _growth_in_motion(time, error, step, scale * (BEYOND if run.completed else BEYOND_BEFORE_FAILURE))
    if found is None and run.completed:
        found = _growth_at_rest(time, error, step, rest, scale)
    if found is None:
        return None
    factor, since = found
    worst = int(error.argmax())
    joint = 1 + [*known][int(abs(errors[worst]).argmax())]
    if factor >= FAST:
        grows = f"grows {factor:.4g}-fold per {unit} of {step:g} s"
    else:
        grows = f"grows tenfold in {step * log(10.0) / log(factor):.3g} s" if factor > 1.0 + ROUNDING else "stays"
    return (
        f"joint{joint}.velocity is up to {error[worst]:.3g} rad/s off its reference, where the motion needs {peak:.3g} rad/s; the error "
        f"{grows} from {since:.6g} s on: the control loop is unstable; {_remedies(run)}"
    )


def usual_speed(run: Run) -> float:
    """The largest velocity [rad/s] that joints of a stable loop have: that of the motion, or of a fall until a controller catches it."""
    fall = sqrt(hypot(*run.scene.effects.gravity) / run.scene.mechanism.proximal.length)
    return max(run.plan.top_speed, fall)


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
                yield f"raise the torque limit of {limit:.3g} N·m or protect integrators against windup"
                break

    *most, last = remedies()
    return f"{', '.join(most)}, or {last}" if most else last
