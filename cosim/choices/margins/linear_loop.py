"""The sampled loop about an equilibrium as a linear periodic system, by lifting over the common period of all sample times.

Between two instants the robot and continuous lags move by the exponential of their matrix, exactly, with what sampled slaves hold.
At an instant those that are due calculate outputs in the order in which the master calls them, then their next states. Products of
these matrices over a period give the closed loop. Before they reach the robot, its torques can be multiplied and delayed: that is
how far the loop is from instability.

Source: T. Chen and B. Francis, *Optimal Sampled-Data Control Systems*, Springer 1995, chapters 8 (lifting) and 10 (multirate).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, reduce
from math import gcd, lcm

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from flexfmu.cosim.choices.margins.linear_blocks import LinearBlock
from flexfmu.cosim.engine.errors import InputError
from flexfmu.trajectories.jets import RealArray

ComplexArray = NDArray[np.complex128]

MOST_INSTANTS = 4000
"""Largest number of instants in a period; sample times without a common period within it can't be lifted."""

FINEST = 10**9
"""Largest denominator of a sample time [s]: times that differ by less than a nanosecond are the same."""


@dataclass(frozen=True, eq=False)
class Continuous:
    """dx/dt = A x + B h + G u with the signals y = C x + D u: the robot and lags in continuous time.

    ``h`` are outputs of sampled slaves that are connected to them, ``u`` the robot's torques of the channels.

    Attributes:
        a, c: A (n, n), C (signals, n).
        held: B (n, outputs of sampled slaves), and their share of the signals (signals, outputs).
        channels: G (n, channels), and D (signals, channels).
    """

    a: RealArray
    c: RealArray
    held: tuple[RealArray, RealArray]
    channels: tuple[RealArray, RealArray]


@dataclass(frozen=True, eq=False)
class Perturbation:
    """What is done to the torques of channels before they reach the robot.

    Attributes:
        factors: complex factor of each channel; 1 for none.
        delay: delay of each channel [s].
    """

    factors: tuple[complex, ...]
    delay: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """A sampled loop.

    Attributes:
        continuous: robot and lags.
        blocks: sampled slaves, in no particular order.
        calls: indices of blocks in the order in which their outputs are calculated at an instant.
        inputs: for each block its inputs from [signals, outputs of all blocks], (m, signals + outputs).
        channels: for each channel the index of the output of the blocks that feeds it.
    """

    continuous: Continuous
    blocks: tuple[LinearBlock, ...]
    calls: tuple[int, ...]
    inputs: tuple[RealArray, ...]
    channels: tuple[int, ...]

    @cached_property
    def period(self) -> Fraction:
        """Common period of all sample times [s]."""
        return _common([_fraction(each.sample_time) for each in self.blocks])

    @cached_property
    def _layout(self) -> tuple[NDArray[np.intp], NDArray[np.intp], int]:
        """Where the states of each block begin, where its outputs do, and the number of outputs; states follow those of x."""
        states = np.cumsum([len(self.continuous.a), *(len(each.a) for each in self.blocks)])
        outputs = np.cumsum([0, *(len(each.c) for each in self.blocks)])
        return states, outputs, int(outputs[-1])

    def owner(self, channel: int) -> LinearBlock:
        """The block that feeds a channel."""
        _, outputs, _ = self._layout
        return self.blocks[int(np.searchsorted(outputs, self.channels[channel], side="right")) - 1]

    def closed(self, perturbation: Perturbation) -> ComplexArray:
        """The matrix of the closed loop over a period."""
        return self._course(perturbation, None)[0]

    def opened(self, channels: Sequence[int]) -> LiftedLoop:
        """The loop that is cut where channels reach the robot."""
        none = Perturbation((1.0,) * len(self.channels), (0.0,) * len(self.channels))
        whole, out, times = self._course(none, channels)
        n = len(whole)
        p = len(times)
        return LiftedLoop(whole[:, :n], whole[:, n:], out[:, :n], out[:, n:], tuple(times), float(self.period), p)

    def _course(
        self, perturbation: Perturbation, cut: Sequence[int] | None
    ) -> tuple[ComplexArray, ComplexArray, list[tuple[int, float]]]:
        """The final state from the state at the start, and from what is fed into cut channels; the cut outputs; their instants.

        The state is [x, states of blocks, outputs of blocks, torques of channels, queues of delayed torques].
        """
        states, _, count = self._layout
        first_output = int(states[-1])
        latched = first_output + count
        course = self._planned(perturbation.delay)
        lengths, queues = course.lengths, np.cumsum([latched + len(self.channels), *course.lengths])
        size = int(queues[-1])
        fed = [(step.channel, step.at) for step in course.steps if cut is not None and step.channel in cut]
        # from [state, fed torques] to the state, instant after instant
        whole = np.hstack([np.eye(size, dtype=complex), np.zeros((size, len(fed)), dtype=complex)])
        found, number = [], 0
        for step in course.steps:
            i = step.channel
            if step.flow is not None:
                whole = step.flow @ whole
            if i < 0:
                before = whole.copy()
                self._sample(whole, before, step.due)
                for j in range(len(self.channels)):
                    if lengths[j] and self._block_of(j) in step.due:
                        queue = slice(int(queues[j]), int(queues[j + 1]))
                        whole[queue] = np.vstack(
                            [before[first_output + self.channels[j]][np.newaxis], whole[queue][:-1]]
                        )
            else:
                source = whole[first_output + self.channels[i]]
                if cut is not None and i in cut:
                    found.append(source.copy())
                    source = np.zeros(whole.shape[1], dtype=complex)
                    source[size + number] = 1.0
                    number += 1
                elif lengths[i]:
                    source = whole[int(queues[i + 1]) - 1]
                whole[latched + i] = perturbation.factors[i] * source
        if course.last is not None:
            whole = course.last @ whole
        return whole, np.array(found), fed

    def _block_of(self, channel: int) -> int:
        _, outputs, _ = self._layout
        return int(np.searchsorted(outputs, self.channels[channel], side="right")) - 1

    def _planned(self, delay: tuple[float, ...]) -> _Course:
        """What happens in a period with these delays of the channels [s]."""
        if delay not in self._plans:
            self._plans[delay] = self._plan(delay)
        return self._plans[delay]

    @cached_property
    def _plans(self) -> dict[tuple[float, ...], _Course]:
        return {}

    @cached_property
    def _times(self) -> list[set[Fraction]]:
        """Instants of each block within a period."""
        if (total := sum(int(self.period / _fraction(block.sample_time)) for block in self.blocks)) > MOST_INSTANTS:
            times = ", ".join(sorted({f"{block.sample_time:g} s" for block in self.blocks}))
            raise InputError(
                f"the sample times {times} have a common period of {float(self.period):g} s with {total} instants; margins need "
                f"one with at most {MOST_INSTANTS}"
            )
        found = []
        for block in self.blocks:
            step, first = _fraction(block.sample_time), _fraction(block.offset)
            found.append({(first + k * step) % self.period for k in range(int(self.period / step))})
        return found

    def _plan(self, delay: tuple[float, ...]) -> _Course:
        """Samples, then torques that reach the robot, in the order of their instants."""
        delays = [_fraction(each) for each in delay]
        owners = [self._block_of(i) for i in range(len(delays))]
        lengths = tuple(
            int(each / _fraction(self.blocks[k].sample_time)) for each, k in zip(delays, owners, strict=True)
        )
        happening = {(at, -1) for times in self._times for at in times}
        happening |= {((at + delays[i]) % self.period, i) for i, k in enumerate(owners) for at in self._times[k]}
        flows = self._flows(sum(lengths))
        steps, now = [], Fraction(0)
        for at, i in sorted(happening):
            due = frozenset(k for k, times in enumerate(self._times) if at in times) if i < 0 else frozenset[int]()
            steps.append(_Step(float(at), i, due, flows.over(at - now) if at > now else None))
            now = at
        return _Course(tuple(steps), flows.over(self.period - now) if now < self.period else None, lengths)

    def _flows(self, queued: int) -> _Flow:
        """The flow between instants, with a number of queued torques."""
        states, _, count = self._layout
        n, first_output, x = len(self.continuous.a), int(states[-1]), self.continuous
        latched = first_output + count
        matrix = np.zeros((latched + len(self.channels),) * 2)
        matrix[:n, :n] = x.a
        matrix[:n, first_output:latched] = x.held[0]
        matrix[:n, latched:] = x.channels[0]
        return _Flow(matrix, queued)

    def _sample(self, whole: ComplexArray, before: ComplexArray, due: frozenset[int]) -> None:
        """Outputs of the blocks that are due, in the order of calls, then their next states."""
        states, outputs, count = self._layout
        first_output = int(states[-1])
        latched = first_output + count

        def taken(k: int) -> ComplexArray:
            signals = self._signals(whole, first_output, latched)
            return np.asarray(self.inputs[k] @ np.vstack([signals, whole[first_output:latched]]))

        for k in self.calls:
            if k in due:
                block, own = self.blocks[k], slice(int(states[k]), int(states[k + 1]))
                out = slice(first_output + int(outputs[k]), first_output + int(outputs[k + 1]))
                whole[out] = block.c @ before[own] + block.d @ taken(k)
        after = {k: taken(k) for k in due}
        for k, inputs in after.items():
            own = slice(int(states[k]), int(states[k + 1]))
            whole[own] = self.blocks[k].a @ before[own] + self.blocks[k].b @ inputs

    def _signals(self, whole: ComplexArray, first_output: int, latched: int) -> ComplexArray:
        """The signals of robot and lags."""
        x, n = self.continuous, len(self.continuous.a)
        torques = whole[latched : latched + len(self.channels)]
        return np.asarray(x.c @ whole[:n] + x.held[1] @ whole[first_output:latched] + x.channels[1] @ torques)


@dataclass(frozen=True, eq=False)
class LiftedLoop:
    """A loop that is cut at channels, lifted over a period: what is fed in (p,) → what comes back (p,).

    Attributes:
        a, b, c, d: of the lifted system.
        times: channel and instant [s] of each of the p elements.
        period: [s].
        size: p.
    """

    a: ComplexArray
    b: ComplexArray
    c: ComplexArray
    d: ComplexArray
    times: tuple[tuple[int, float], ...]
    period: float
    size: int

    def response(self, frequency: RealArray) -> ComplexArray:
        """Loop transfer functions L at angular frequencies (N,) [rad/s], (N, p, p), for negative feedback: 1 + L."""
        z = np.exp(1j * frequency * self.period)
        inside = z[:, np.newaxis, np.newaxis] * np.eye(len(self.a)) - self.a
        return np.asarray(-(self.c @ np.linalg.solve(inside, self.b[np.newaxis]) + self.d))

    def fundamental(self, frequency: RealArray) -> ComplexArray:
        """The part of the loop transfer functions that keeps the frequency, (N, channels, channels)."""
        lifted = self.response(frequency)
        channels = sorted({i for i, _ in self.times})
        instants = np.array([t for _, t in self.times])
        of = np.array([channels.index(i) for i, _ in self.times])
        shifted = lifted * np.exp(-1j * frequency[:, np.newaxis, np.newaxis] * (instants[:, np.newaxis] - instants))
        found = np.zeros((len(frequency), len(channels), len(channels)), dtype=complex)
        for row in range(len(channels)):
            for column in range(len(channels)):
                part = shifted[:, of == row][:, :, of == column]
                found[:, row, column] = part.sum(axis=(1, 2)) / (of == row).sum()
        return found


@dataclass(frozen=True, eq=False)
class _Step:
    """An instant: samples of the blocks that are due (channel -1), or a torque that reaches the robot; before it the flow."""

    at: float
    channel: int
    due: frozenset[int]
    flow: RealArray | None


@dataclass(frozen=True, eq=False)
class _Course:
    """A period: its steps, the flow to its end, and the number of queued torques of each channel."""

    steps: tuple[_Step, ...]
    last: RealArray | None
    lengths: tuple[int, ...]


class _Flow:
    """Exponentials of the matrix of the continuous states, of which there are few different ones."""

    def __init__(self, matrix: RealArray, queued: int) -> None:
        self._matrix, self._queued = matrix, queued
        self._known: dict[Fraction, RealArray] = {}

    def over(self, time: Fraction) -> RealArray:
        """The matrix over a time; queued torques stay."""
        if time not in self._known:
            moved = expm(self._matrix * float(time))
            self._known[time] = block_diag(moved, np.eye(self._queued)) if self._queued else moved
        return self._known[time]


def _fraction(time: float) -> Fraction:
    return Fraction(time).limit_denominator(FINEST)


def _common(times: Sequence[Fraction]) -> Fraction:
    """The least common multiple of times."""
    numerators, denominators = [each.numerator for each in times], [each.denominator for each in times]
    return Fraction(reduce(lcm, numerators), reduce(gcd, denominators))
