"""The size of a run's recording before it starts, and what to do about one that is too large.

A duration in milliseconds where seconds are meant fills memory and disk. What is too large is refused, with the likely mistake.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.engine.slave import GivesOutputDerivatives, Sampled
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.system import SceneSystem

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
        names = (f"{slave.name}.{each.name}" for each in slave.variables if each.causality == "output")
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
