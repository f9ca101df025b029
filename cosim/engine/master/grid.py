"""The time grid of a run: ticks start + n * step, sample instants and marks, all of them met exactly."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import ceil, lcm

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.system import System
from flexfmu.cosim.engine.slave import (
    COINCIDENT,
    HasBreakpoints,
    LimitsStep,
    MayNeedRegularSteps,
    RealArray,
    Sampled,
    offset,
)

Flags = NDArray[np.bool_]

MAXIMUM_POINTS = 20_000_000
"""More communication points than this are refused: the step is probably in a wrong unit."""


MAXIMUM_RATIO = 1000
"""Sample times must be p/q communication steps with q up to this.

The fractions are so few that a random ratio is one of them, within `RATIO_TOLERANCE`, less than once in a million."""

RATIO_TOLERANCE = 1e-12
"""Relative rounding error of a ratio of two times that users have typed in or calculated."""

SUGGESTED_RATIO = 10
"""Largest denominator of a sample time that an error message suggests."""

MAXIMUM_TICKS = 100_000
"""Largest number of common ticks in a communication step; two of them stay further apart than `COINCIDENT`."""


@dataclass(frozen=True)
class Clock:
    """Sample instants of a slave: start + offset + k * sample_time, k = 0, 1, ..

    Attributes:
        name: the slave's name.
        sample_time: [s], above zero.
        offset: first sample instant after the start [s], zero or positive.
    """

    name: str
    sample_time: float
    offset: float = 0.0


@dataclass(frozen=True)
class TimeGrid:
    """Communication points of a run.

    Attributes:
        times: (N + 1,) communication points [s], strictly increasing, from start to stop.
        marked: (N + 1,) whether signals may jump at the point: breakpoints and sample instants.
        due: for each clock (N + 1,) whether its slave samples at the point.
    """

    times: RealArray
    marked: Flags
    due: tuple[Flags, ...] = ()

    @cached_property
    def largest_step(self) -> float:
        """Longest communication step [s]."""
        return float(np.diff(self.times).max())


def system_grid(system: System, start: float, stop: float, step: float, ticks: bool) -> TimeGrid:
    """The communication points of a run.

    Args:
        system: the slaves.
        start, stop: [s].
        step: communication step [s]; it is divided for slaves that limit it.
        ticks: whether the points start + n * step belong to the grid, besides breakpoints and sample instants.

    Raises:
        InputError: as `time_grid`; or a slave needs steps shorter than 1 / `MAXIMUM_RATIO` of the communication step.
    """
    # sample instants, and breakpoints
    clocks = [Clock(s.name, s.sample_time, offset(s)) for s in system.slaves if isinstance(s, Sampled)]
    marks = [mark for slave in system.slaves if isinstance(slave, HasBreakpoints) for mark in slave.breakpoints]
    # divide the communication step for slaves that limit it
    parts = 1
    for slave in system.slaves:
        if isinstance(slave, LimitsStep):
            wanted = step / slave.largest_step
            if not wanted < MAXIMUM_RATIO:
                raise InputError(
                    f"{slave.name} needs steps of {slave.largest_step:g} s, {wanted:.3g} of them in a communication step of "
                    f"{step:g} s; what is that fast hardly matters: leave it out, or take a smaller step"
                )
            parts = max(parts, ceil(wanted - COINCIDENT))
    return time_grid(start, stop, step / parts, marks, clocks, ticks=ticks)


def check_regular_steps(system: System, grid: TimeGrid, step: float, varies: bool) -> None:
    """Check that slaves that need equal communication steps get them.

    Args:
        system: the slaves.
        grid: communication points.
        step: communication step [s], for the message.
        varies: whether step control chooses the steps.

    Raises:
        InputError: a slave needs equal steps, but they differ or step control chooses them.
    """
    # equal steps suit all slaves
    steps = np.diff(grid.times)
    least, largest = float(steps.min()), float(steps.max())
    if largest - least <= COINCIDENT * largest and not varies:
        return
    for slave in system.slaves:
        if isinstance(slave, MayNeedRegularSteps) and slave.needs_regular_steps and not isinstance(slave, Sampled):
            found = f"this run lands on breakpoints, sample instants and its end in steps of {least:.6g} s to {largest:.6g} s"
            found = "step control chooses them as they come" if varies else found
            raise InputError(
                f"{slave.name} takes equal communication steps alone (canHandleVariableCommunicationStepSize = false), but "
                f"{found}; give it a sample time of its own [s]: sample_time = {step:.6g} in its table, or "
                f"fmu_slave(path, sample_time={step:.6g})"
            )


def time_grid(
    start: float,
    stop: float,
    step: float,
    marks: Iterable[float] = (),
    clocks: Sequence[Clock] = (),
    *,
    ticks: bool = True,
) -> TimeGrid:
    """The grid of ticks start + n * step, sample instants and marks from start to stop; the last step may be shorter.

    Sample instants and ticks are integer multiples of one common tick and compared as integers, so that coinciding ones
    become one point, however long the run.

    Args:
        start, stop, step: [s].
        marks: further points, at which signals may jump [s].
        clocks: sample times of the sampled slaves.
        ticks: whether the points start + n * step belong to the grid.

    Raises:
        InputError: the step isn't positive, the stop isn't after the start, there would be more than `MAXIMUM_POINTS`
            points, or a clock and the step have no common tick.
    """
    if not 0.0 < step < np.inf:
        raise InputError(f"the communication step must be above 0 s and finite, got {step:g} s")
    if not -np.inf < start < stop < np.inf:
        raise InputError(f"the run must end after its start, got start {start:g} s, stop {stop:g} s")
    if (stop - start) / step > MAXIMUM_POINTS:
        raise InputError(
            f"a communication step of {step:g} s makes {(stop - start) / step:.3g} steps; take a larger one"
        )
    # regular points: ticks and sample instants
    near = COINCIDENT * step
    instants = [sample_instants(clock, start, stop, near) for clock in clocks]
    regular = _regular_points(start, stop, step, clocks, instants, ticks)
    # marks, start and stop replace the regular points that coincide with them
    inside = [mark for mark in marks if start - near < mark < stop + near]
    fixed = merge([start, stop, *inside], near)
    fixed[0], fixed[-1] = start, stop
    times = np.union1d(regular[(_distance(regular, fixed) > near) & (regular < stop)], fixed)
    # where slaves sample, and where signals may jump
    due = tuple(_nearest(times, each) for each in instants)
    marked = _distance(times, np.asarray(inside)) <= near if inside else np.zeros(times.shape, dtype=np.bool_)
    return TimeGrid(times, np.logical_or.reduce([marked, *due]), due)


def _regular_points(
    start: float, stop: float, step: float, clocks: Sequence[Clock], instants: Sequence[RealArray], ticks: bool
) -> RealArray:
    """Ticks and sample instants [s] without repetition; of coinciding ones the tick's time, or the first clock's."""
    # a common tick of the step and all sample times
    ratios = [(_ratio(clock, "sample time", step), _ratio(clock, "offset", step)) for clock in clocks]
    per_step = lcm(*(ratio.denominator for pair in ratios for ratio in pair))
    if per_step > MAXIMUM_TICKS:
        names = ", ".join(f"{clock.name} {clock.sample_time:g} s" for clock in clocks)
        raise InputError(
            f"the sample times of {names} and the communication step of {step:g} s have no common tick above "
            f"{1.0 / MAXIMUM_TICKS:g} of that step; take sample times that divide it or are multiples of it"
        )
    count = int((stop - start) / step + 1.0) if ticks else 0
    # express each point in common ticks, and keep the first of equal ones
    numbers = [per_step * np.arange(count, dtype=np.int64)]
    times = [start + step * np.arange(count, dtype=np.float64)]
    for (period, first), each in zip(ratios, instants, strict=True):
        numbers.append(int(first * per_step) + int(period * per_step) * np.arange(each.size, dtype=np.int64))
        times.append(each)
    _, first_of_each = np.unique(np.concatenate(numbers), return_index=True)
    return np.concatenate(times)[first_of_each]


def _ratio(clock: Clock, what: str, step: float) -> Fraction:
    """The clock's sample time or offset (``what``) divided by the communication step.

    Raises:
        InputError: the ratio is no fraction with a denominator up to `MAXIMUM_RATIO`.
    """
    value = clock.offset if what == "offset" else clock.sample_time
    exact = value / step
    if 0.0 < exact < (1.0 - RATIO_TOLERANCE) / MAXIMUM_RATIO:
        raise InputError(
            f"{clock.name}: its {what} of {value:.12g} s is less than 1/{MAXIMUM_RATIO} of the communication step of "
            f"{step:.12g} s; take at least {step / MAXIMUM_RATIO:.12g} s, or a communication step of at most "
            f"{value * MAXIMUM_RATIO:.12g} s"
        )
    # a fraction within rounding errors
    ratio = Fraction(exact).limit_denominator(MAXIMUM_RATIO)
    if abs(float(ratio) - exact) <= RATIO_TOLERANCE * exact:
        return ratio
    # else suggest times near by that fit, or another communication step
    below = Fraction(exact).limit_denominator(SUGGESTED_RATIO)
    whole = max(1, round(exact)) if exact > 0.5 else Fraction(1, round(1.0 / exact))
    fitting = " or ".join(
        dict.fromkeys(f"{float(each) * step:.12g} s" for each in (below, Fraction(whole)) if each > 0)
    )
    other = value / float(whole)
    raise InputError(
        f"{clock.name}: its {what} of {value:.12g} s doesn't fit the communication step of {step:.12g} s, they have no "
        f"common tick; the nearest that fit are {fitting}, or take a communication step of {other:.12g} s"
    )


def merge(instants: Iterable[float], near: float) -> RealArray:
    """The instants in ascending order, without those that follow the one before by ``near`` or less."""
    ascending = np.unique(np.fromiter(instants, dtype=np.float64))
    return ascending[np.diff(ascending, prepend=-np.inf) > near]


def _distance(times: RealArray, marks: RealArray) -> RealArray:
    """Distance of each time to the nearest mark; ``marks`` need not be sorted."""
    ascending = np.sort(marks)
    after = np.searchsorted(ascending, times).clip(0, ascending.size - 1)
    before = (after - 1).clip(0)
    distance: RealArray = np.minimum(abs(ascending[after] - times), abs(ascending[before] - times))
    return distance


def sample_instants(clock: Clock, start: float, stop: float, near: float = 0.0) -> RealArray:
    """Instants start + offset + k * sample_time up to ``stop`` + ``near`` [s].

    Raises:
        InputError: the sample time isn't positive, the offset is negative or infinite, or there would be more than
            `MAXIMUM_POINTS` instants.
    """
    if not 0.0 < clock.sample_time < np.inf or (stop - start) / clock.sample_time > MAXIMUM_POINTS:
        raise InputError(
            f"{clock.name}: a sample time of {clock.sample_time} s doesn't suit a run from {start} s to {stop} s"
        )
    if not 0.0 <= clock.offset < np.inf:
        raise InputError(f"{clock.name}: the offset must be zero or positive, got {clock.offset} s")
    # calculate each instant from its index, so that rounding errors don't add up
    count = max(0, int((stop - start - clock.offset + near) / clock.sample_time + 1.0))
    return start + (clock.offset + clock.sample_time * np.arange(count, dtype=np.float64))


def _nearest(times: RealArray, instants: RealArray) -> Flags:
    """(N + 1,) whether the time is the nearest one to an instant."""
    points: Flags = np.zeros(times.shape, dtype=np.bool_)
    after = np.searchsorted(times, instants).clip(1, times.size - 1)
    nearer_before = instants - times[after - 1] < times[after] - instants
    points[after - nearer_before] = True
    return points
