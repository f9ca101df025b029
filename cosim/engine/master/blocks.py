"""The communication points of a run, block by block, so that long runs take no more memory than short ones.

Blocks begin at ticks. Where a motion repeats after a whole number of ticks, so do the blocks: what was calculated for
the points of one cycle holds for the next ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, inf

import numpy as np

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.grid import MAXIMUM_RATIO, NO_POINTS, Clock, GridRules, TimeGrid
from flexfmu.cosim.engine.master.system import System
from flexfmu.cosim.engine.slave import (
    COINCIDENT,
    HasBreakpoints,
    RealArray,
    Sampled,
    offset,
)

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
