"""The communication points of a run: ticks start + n * step, sample instants and marks, all of them met exactly.

They come block by block, so that long runs take no more memory than short ones. Blocks begin at ticks. Where a motion repeats after a
whole number of ticks, so do the blocks: what was calculated for the points of one cycle holds for the next ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from math import ceil, inf, lcm

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.system import System
from flexfmu.cosim.engine.slave import COINCIDENT, HasBreakpoints, Indices, RealArray, Sampled, offset

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
            regular = np.sort(np.concatenate([regular, further]))  # `np.union1d` would load numpy.ma
            regular = regular[np.diff(regular, prepend=-np.inf) > 0.0]
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
        for (period, begin), (each, when) in zip(ratios, instants, strict=True):
            numbers.append(int(begin * per_step) + int(period * per_step) * each)
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


BLOCK = 2048
"""Largest number of ticks, or of sample instants of a slave, in a block."""

SHORTEST = 64
"""A last block with fewer points belongs to the block before."""

KEPT = 128
"""Largest number of blocks that are kept, 3 MB; those of longer runs are calculated again in every run."""

CYCLES = 16
"""Largest number of cycles after which the points of the grid repeat."""


@dataclass(frozen=True)
class Block:
    """Communication points of a part of a run; it begins where the block before ends.

    Attributes:
        grid: the points (N + 1,): the N steps of the block lie between them.
        after: the first point of the next block [s], to which the step after the last point leads; None at the end.
    """

    grid: TimeGrid
    after: float | None = None

    @property
    def steps(self) -> int:
        """Number of communication steps N."""
        return self.grid.times.size - 1

    @property
    def known(self) -> RealArray:
        """The points, and ``after`` (N + 1,) or (N + 2,) [s]."""
        return self.grid.times if self.after is None else np.append(self.grid.times, self.after)


class RunGrid:
    """The communication points of a run.

    Args:
        rules: which points there are.
        period: period of the motion [s]; 0 if it doesn't repeat.

    Attributes:
        start, stop: [s].
        steps: number of communication steps.
        records: number of recorded instants; those where signals may jump count twice.
        jumps: number of points at which signals may jump.
        most: largest number of steps in a block.
        least_step, largest_step: shortest and longest communication step [s].
    """

    def __init__(self, rules: GridRules, period: float = 0.0) -> None:
        self._rules, self.start, self.stop = rules, rules.start, rules.stop
        self._ticks, self._parts = _cycle(rules, period)
        self._kept: list[Block] = []
        # one pass over all blocks counts them, and keeps a few
        kept: list[Block] = []
        self.steps = self.most = self.records = count = 0
        self.jumps, self.least_step, self.largest_step = 0, inf, 0.0
        for count, block in enumerate(self.blocks(), start=1):
            widths = np.diff(block.grid.times)
            self.steps, self.most = self.steps + block.steps, max(self.most, block.steps)
            # the first point of a later block is the last one of the block before
            own = slice(int(count > 1), None)
            self.jumps += int(block.grid.marked[own].sum())
            self.records += int((block.grid.instants * (1 + block.grid.marked))[own].sum())
            self.least_step = min(self.least_step, float(widths.min()))
            self.largest_step = max(self.largest_step, float(widths.max()))
            if count <= KEPT:
                kept.append(block)
        self._kept = kept if count <= KEPT else []

    def blocks(self) -> Iterator[Block]:
        """All blocks in order."""
        if self._kept:
            yield from self._kept
            return
        held: TimeGrid | None = None
        for part in self._pieces():
            # a block waits for the next one, whose first point it needs; the next one begins at its last point
            if held is None:
                held = part
            elif part.times.size:
                yield Block(held, float(part.times[0]))
                held = _joined(held.part(slice(-1, None)), part)
        assert held is not None
        yield Block(held)

    def _pieces(self) -> Iterator[TimeGrid]:
        """The points between the cuts, without repetition; a short rest is part of the last one."""
        step, low, number = self._rules.step, -inf, 1
        while True:
            cut = number // self._parts * self._ticks + number % self._parts * self._ticks // self._parts
            # between two ticks, which may be replaced by marks beside them
            high = self.start + (cut - 0.5) * step
            if not high + SHORTEST * step < self.stop or not (self._rules.ticks or self._rules.points.size):
                yield self._rules.between(low)
                return
            yield self._rules.between(low, high)
            low, number = high, number + 1


def _joined(first: TimeGrid, second: TimeGrid) -> TimeGrid:
    """The points of both parts."""
    due = tuple(np.concatenate(pair) for pair in zip(first.due, second.due, strict=True))
    times, marked = np.concatenate([first.times, second.times]), np.concatenate([first.marked, second.marked])
    recorded = None if first.recorded is None else np.concatenate([first.instants, second.instants])
    return TimeGrid(times, marked, due, recorded)


def _cycle(rules: GridRules, period: float) -> tuple[int, int]:
    """Number of ticks after which the points repeat, a multiple of them if it is small, and number of blocks in them."""
    fastest = min((clock.sample_time for clock in rules.clocks), default=rules.step)
    largest = max(1, int(BLOCK * min(1.0, fastest / rules.step)))
    ratio = Fraction(period / rules.step).limit_denominator(CYCLES)
    # up to the end of the run the cycles must not drift away from the ticks
    drift = abs(float(ratio) * rules.step - period) * (rules.stop - rules.start) / period if period > 0.0 else inf
    if ratio <= 0 or drift > 0.1 * rules.near:
        return largest, 1
    ticks = ratio.numerator * max(1, largest // ratio.numerator)
    return ticks, ceil(ticks / largest)


def system_grid(
    system: System,
    start: float,
    stop: float,
    step: float,
    ticks: bool,
    points: RealArray = NO_POINTS,
    record_step: float | None = None,
) -> RunGrid:
    """The communication points of a run.

    Args:
        system: the slaves.
        start, stop: [s].
        step: communication step [s]; it is divided for slaves that limit it.
        ticks: whether the points start + n * step belong to the grid, besides breakpoints and sample instants.
        points: further points, ascending [s].
        record_step: interval of the recorded points [s]; None for all.

    Raises:
        InputError: as `GridRules`; or a slave needs steps shorter than 1 / `MAXIMUM_RATIO` of the communication step.
    """
    # sample instants, breakpoints, and the period of a repeated motion
    clocks = [
        Clock(s.name, s.sample_time, offset(s), tuple(getattr(s, "instants", ())))
        for s in system.slaves
        if isinstance(s, Sampled)
    ]
    marks = [mark for slave in system.slaves if isinstance(slave, HasBreakpoints) for mark in slave.breakpoints]
    period = max((getattr(s, "period", 0.0) for s in system.slaves if isinstance(s, HasBreakpoints)), default=0.0)
    # divide the communication step for slaves that limit it
    parts = 1
    for slave in system.slaves:
        if (largest := getattr(slave, "largest_step", None)) is not None:
            wanted = step / largest
            if not wanted < MAXIMUM_RATIO:
                raise InputError(
                    f"{slave.name} needs steps of {largest:g} s, {wanted:.3g} of them in a communication step of "
                    f"{step:g} s; what is that fast hardly matters: leave it out, or take a smaller step"
                )
            parts = max(parts, ceil(wanted - COINCIDENT))
    return RunGrid(GridRules(start, stop, step / parts, marks, clocks, ticks, points, record_step), period)


def check_regular_steps(system: System, grid: RunGrid, step: float, varies: bool) -> None:
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
    least, largest = grid.least_step, grid.largest_step
    if largest - least <= COINCIDENT * largest and not varies:
        return
    for slave in system.slaves:
        if getattr(slave, "needs_regular_steps", False) and not isinstance(slave, Sampled):
            found = f"this run lands on breakpoints, sample instants and its end in steps of {least:.6g} s to {largest:.6g} s"
            found = "step control chooses them as they come" if varies else found
            raise InputError(
                f"{slave.name} takes equal communication steps alone (canHandleVariableCommunicationStepSize = false), but "
                f"{found}; give it a sample time of its own [s]: sample_time = {step:.6g} in its table, or "
                f"fmu_slave(path, sample_time={step:.6g})"
            )
