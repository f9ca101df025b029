"""The time grid of a run: ticks start + n * step, sample instants and marks, all of them met exactly."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from math import lcm

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import COINCIDENT, Indices, RealArray

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

NO_POINTS = np.empty(0)
"""No points besides the others."""


@dataclass(frozen=True)
class Clock:
    """Sample instants of a slave: start + offset + k * sample_time, k = 0, 1, .., and others.

    Attributes:
        name: the slave's name.
        sample_time: [s], above zero; infinite for `instants` alone.
        offset: first sample instant after the start [s], zero or positive.
        instants: further sample instants after the start [s], ascending; they needn't fit any step.
    """

    name: str
    sample_time: float
    offset: float = 0.0
    instants: tuple[float, ...] = ()

    @property
    def is_regular(self) -> bool:
        """Whether there are instants start + offset + k * sample_time."""
        return self.sample_time < np.inf


@dataclass(frozen=True)
class TimeGrid:
    """Communication points of a run, or of a part of it.

    Attributes:
        times: (N + 1,) communication points [s], strictly increasing.
        marked: (N + 1,) whether signals may jump at the point: breakpoints and sample instants.
        due: for each clock (N + 1,) whether its slave samples at the point.
        recorded: (N + 1,) whether signals are recorded at the point; None for all points.
    """

    times: RealArray
    marked: Flags
    due: tuple[Flags, ...] = ()
    recorded: Flags | None = None

    @property
    def instants(self) -> Flags:
        """(N + 1,) whether signals are recorded at the point."""
        return np.ones(self.times.shape, dtype=np.bool_) if self.recorded is None else self.recorded

    def part(self, points: slice | Flags) -> TimeGrid:
        """Some of the points."""
        due = tuple(each[points] for each in self.due)
        return TimeGrid(
            self.times[points], self.marked[points], due, None if self.recorded is None else self.recorded[points]
        )


@dataclass(frozen=True)
class GridRules:
    """What the communication points of a run are: ticks start + n * step, sample instants and marks.

    Sample instants and ticks are integer multiples of one common tick and compared as integers, so that coinciding ones
    become one point, however long the run. Start, stop and marks replace the ticks and sample instants beside them.

    Attributes:
        start, stop, step: [s].
        marks: further points, at which signals may jump [s].
        clocks: sample times of the sampled slaves.
        ticks: whether the points start + n * step belong to the grid.
        points: further points, ascending, at which nothing jumps [s].
        record_step: interval of the recorded points [s], besides marks, start and stop; None for all points.

    Raises:
        InputError: the step isn't positive, the stop isn't after the start, there would be more than `MAXIMUM_POINTS`
            points, or a clock and the step have no common tick.
    """

    start: float
    stop: float
    step: float
    marks: Sequence[float] = ()
    clocks: Sequence[Clock] = ()
    ticks: bool = True
    points: RealArray = field(default_factory=lambda: NO_POINTS)
    record_step: float | None = None

    def __post_init__(self) -> None:
        start, stop, step = self.start, self.stop, self.step
        if not 0.0 < step < np.inf:
            raise InputError(f"the communication step must be above 0 s and finite, got {step:g} s")
        if not -np.inf < start < stop < np.inf:
            raise InputError(f"the run must end after its start, got start {start:g} s, stop {stop:g} s")
        if (stop - start) / step > MAXIMUM_POINTS:
            raise InputError(
                f"a communication step of {step:g} s makes {(stop - start) / step:.3g} steps; take a larger one"
            )
        for clock in self.clocks:
            _check_clock(clock, start, stop, self.near)
        if self.record_step is not None:
            multiple = self.record_step / step
            if not 0.5 < multiple < np.inf or abs(multiple - round(multiple)) > RATIO_TOLERANCE * multiple:
                raise InputError(
                    f"signals can be recorded every whole number of communication steps of {step:.12g} s, not every "
                    f"{self.record_step:.12g} s; {max(1, round(multiple)) * step:.12g} s fits"
                )
        _ = self._ratios

    @property
    def near(self) -> float:
        """Distance within which two instants are one point [s]."""
        return COINCIDENT * self.step

    @cached_property
    def inside(self) -> RealArray:
        """The marks and the further sample instants within the run, ascending [s]."""
        further = (self.start + each for clock in self.clocks for each in clock.instants)
        marks = np.sort(np.fromiter((*self.marks, *further), dtype=np.float64))
        return marks[(marks > self.start - self.near) & (marks < self.stop + self.near)]

    def between(self, low: float = -np.inf, high: float = np.inf) -> TimeGrid:
        """The points from ``low`` to before ``high`` [s]: the same as those of the whole run."""
        # with a step more on both sides, since coinciding instants may be on either side of the limits
        first, last = low - self.step, high + self.step
        instants = [_instants(clock, self, first, last) for clock in self.clocks if clock.is_regular]
        further = self.points[self.points.searchsorted(first) : self.points.searchsorted(last)]
        regular = self._regular_points(instants, first, last)
        if instants or further.size:
            regular = _union(regular, further)
        # marks, start and stop replace the regular points that coincide with them
        marks = self.inside[self.inside.searchsorted(first) : self.inside.searchsorted(last)]
        ends = [end for end in (self.start, self.stop) if first <= end < last]
        fixed = merge([*ends, *marks], self.near)
        if self.start in ends:
            fixed[0] = self.start
        if self.stop in ends:
            fixed[-1] = self.stop
        apart = ~_beside(regular, fixed, self.near)
        others = regular[apart & (regular < self.stop)]
        times = np.insert(others, others.searchsorted(fixed), fixed)
        # where slaves sample, and where signals may jump
        regularly = (times_due for _, times_due in instants)
        due = tuple(
            _nearest(
                times, np.append(next(regularly) if clock.is_regular else NO_POINTS, self._further(clock, first, last))
            )
            for clock in self.clocks
        )
        marked = _beside(times, marks, self.near)
        recorded = None
        if self.record_step is not None:
            nearest = self.start + self.record_step * np.rint((times - self.start) / self.record_step)
            recorded = marked | (abs(times - nearest) <= self.near) | (times == self.stop)
        grid = TimeGrid(times, np.logical_or.reduce([marked, *due]), due, recorded)
        return grid if first == -np.inf and last == np.inf else grid.part((times >= low) & (times < high))

    def _further(self, clock: Clock, first: float, last: float) -> RealArray:
        """The further sample instants of a clock from ``first`` to ``last`` within the run [s]."""
        instants = self.start + np.array(clock.instants, dtype=float)
        return instants[(instants >= first) & (instants < last) & (instants < self.stop + self.near)]

    def _regular_points(self, instants: Sequence[tuple[Indices, RealArray]], first: float, last: float) -> RealArray:
        """Ticks and sample instants [s] without repetition; of coinciding ones the tick's time, or the first clock's."""
        per_step, ratios = self._ratios
        count = int((self.stop - self.start) / self.step + 1.0) if self.ticks else 0
        tick = _numbers(first - self.start, last - self.start, self.step, count)
        if not ratios:
            return self.start + self.step * tick.astype(np.float64)
        # express each point in common ticks, and keep the first of equal ones
        numbers, times = [per_step * tick], [self.start + self.step * tick.astype(np.float64)]
        for (period, offset), (each, when) in zip(ratios, instants, strict=True):
            numbers.append(int(offset * per_step) + int(period * per_step) * each)
            times.append(when)
        _, first_of_each = np.unique(np.concatenate(numbers), return_index=True)
        return np.concatenate(times)[first_of_each]

    @cached_property
    def _ratios(self) -> tuple[int, list[tuple[Fraction, Fraction]]]:
        """Common ticks in a communication step; sample time and offset of each regular clock in communication steps."""
        clocks, step = [clock for clock in self.clocks if clock.is_regular], self.step
        ratios = [(_ratio(clock, "sample time", step), _ratio(clock, "offset", step)) for clock in clocks]
        per_step = lcm(*(ratio.denominator for pair in ratios for ratio in pair))
        if per_step > MAXIMUM_TICKS:
            names = ", ".join(f"{clock.name} {clock.sample_time:g} s" for clock in clocks)
            raise InputError(
                f"the sample times of {names} and the communication step of {step:g} s have no common tick above "
                f"{1.0 / MAXIMUM_TICKS:g} of that step; take sample times that divide it or are multiples of it"
            )
        return per_step, ratios


def time_grid(
    start: float,
    stop: float,
    step: float,
    marks: Iterable[float] = (),
    clocks: Sequence[Clock] = (),
    *,
    ticks: bool = True,
) -> TimeGrid:
    """All points of the grid that `GridRules` describes; arguments and errors are the same."""
    return GridRules(start, stop, step, tuple(marks), clocks, ticks).between()


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


def _union(first: RealArray, second: RealArray) -> RealArray:
    """All instants of both in ascending order, each once; without numpy's masked arrays, which `np.union1d` loads."""
    ascending = np.sort(np.concatenate([first, second]))
    return ascending[np.diff(ascending, prepend=-np.inf) > 0.0]


def merge(instants: Iterable[float], near: float) -> RealArray:
    """The instants in ascending order, without those that follow the one before by ``near`` or less."""
    ascending = np.sort(np.fromiter(instants, dtype=np.float64))
    return ascending[np.diff(ascending, prepend=-np.inf) > near]


def _beside(times: RealArray, marks: RealArray, near: float) -> Flags:
    """Whether each of the ascending times is within ``near`` of a mark."""
    # count the neighbourhoods that begin and end before each time
    changes = np.zeros(times.size + 1, dtype=np.int64)
    np.add.at(changes, times.searchsorted(marks - near), 1)
    np.add.at(changes, times.searchsorted(marks + near, "right"), -1)
    beside: Flags = np.cumsum(changes[:-1]) > 0
    return beside


def _check_clock(clock: Clock, start: float, stop: float, near: float) -> None:
    """Check a clock.

    Raises:
        InputError: the sample time isn't positive, the offset is negative or infinite, there would be more than
            `MAXIMUM_POINTS` instants, or further instants are within ``near`` [s] of each other, one communication point.
    """
    for one, other in pairwise(clock.instants):
        if other - one <= near:
            raise InputError(
                f"{clock.name}: its instants {one!r} s and {other!r} s are one at this communication step, take instants more "
                f"than {near:.3g} s apart or a smaller step"
            )
    if clock.instants and clock.sample_time == np.inf:
        return
    if not 0.0 < clock.sample_time < np.inf or (stop - start) / clock.sample_time > MAXIMUM_POINTS:
        raise InputError(
            f"{clock.name}: a sample time of {clock.sample_time} s doesn't suit a run from {start} s to {stop} s"
        )
    if not 0.0 <= clock.offset < np.inf:
        raise InputError(f"{clock.name}: the offset must be zero or positive, got {clock.offset} s")


def _instants(clock: Clock, rules: GridRules, first: float, last: float) -> tuple[Indices, RealArray]:
    """Numbers k and sample instants start + offset + k * sample_time [s] from ``first`` to ``last``, within the run."""
    # calculate each instant from its number, so that rounding errors don't add up
    count = max(0, int((rules.stop - rules.start - clock.offset + rules.near) / clock.sample_time + 1.0))
    begin = rules.start + clock.offset
    numbers = _numbers(first - begin, last - begin, clock.sample_time, count)
    return numbers, rules.start + (clock.offset + clock.sample_time * numbers.astype(np.float64))


def _numbers(first: float, last: float, step: float, count: int) -> Indices:
    """The numbers n < ``count`` of multiples n * step from ``first`` to ``last`` [s], and perhaps one more on each side."""
    begin = 0 if first == -np.inf else int(np.clip(first / step, 0, count))
    end = count if last == np.inf else int(np.clip(last / step + 1.0, begin, count))
    return np.arange(begin, end, dtype=np.int64)


def _nearest(times: RealArray, instants: RealArray) -> Flags:
    """(N + 1,) whether the time is the nearest one to an instant."""
    points: Flags = np.zeros(times.shape, dtype=np.bool_)
    if not instants.size:
        return points
    after = np.searchsorted(times, instants).clip(1, times.size - 1)
    nearer_before = instants - times[after - 1] < times[after] - instants
    points[after - nearer_before] = True
    return points
