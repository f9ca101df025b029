"""The sampled loop about an equilibrium as a linear periodic system, by lifting over the common period of all sample times.

Between two instants the robot and continuous lags move by the exponential of their matrix, exactly, with what sampled slaves hold.
At an instant those that are due calculate outputs in the order in which the master calls them, then their next states. Products of
these matrices over a period give the loop that is cut where torques reach the robot. Closed again with torques that are multiplied and
delayed, it tells how far the loop is from instability. Frequency responses come from its complex Schur form, at all frequencies at once.

Source: T. Chen and B. Francis, *Optimal Sampled-Data Control Systems*, Springer 1995, chapters 8 (lifting) and 10 (multirate).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, lru_cache, reduce
from math import gcd, lcm
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm, schur

from flexfmu.cosim.design.margins.linear_blocks import LinearBlock
from flexfmu.cosim.engine.errors import InputError
from flexfmu.trajectories.jets import RealArray

ComplexArray = NDArray[np.complex128]

MOST_INSTANTS = 4000
"""Largest number of instants in a period; sample times without a common period within it can't be lifted."""

FINEST = 10**9
"""Largest denominator of a sample time [s]: times that differ by less than a nanosecond are the same."""

TINY = 1e-15
"""Distance from a pole of a point that is on it."""


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
    _cuts: dict[tuple[Fraction, ...], LiftedLoop] = field(init=False, repr=False, default_factory=dict)
    _flows: dict[Fraction, RealArray] = field(init=False, repr=False, default_factory=dict)
    _samples: dict[frozenset[int], RealArray] = field(init=False, repr=False, default_factory=dict)

    @cached_property
    def period(self) -> Fraction:
        """Common period of all sample times [s]."""
        times = [_fraction(each.sample_time) for each in self.blocks]
        return Fraction(
            reduce(lcm, (each.numerator for each in times)), reduce(gcd, (each.denominator for each in times))
        )

    @property
    def lifted(self) -> LiftedLoop:
        """The loop that is cut where all channels reach the robot; every factor and every group of channels follows from it."""
        return self._cut((Fraction(0),) * len(self.channels))

    @cached_property
    def owners(self) -> list[int]:
        """For each channel the index of the block that feeds it."""
        _, outputs, _ = self._layout
        return [int(np.searchsorted(outputs, each, side="right")) - 1 for each in self.channels]

    def closed(self, factors: Sequence[complex], delays: Sequence[float]) -> NDArray[Any]:
        """The matrix of the closed loop over a period, with a complex factor and a delay [s] of each channel's torque."""
        times = [_fraction(self.blocks[k].sample_time) for k in self.owners]
        parts = [divmod(_fraction(delay), time) for delay, time in zip(delays, times, strict=True)]
        return self._cut(tuple(late for _, late in parts)).closed(factors, [whole for whole, _ in parts])

    @cached_property
    def _layout(self) -> tuple[NDArray[np.intp], NDArray[np.intp], int]:
        """Where the states of each block begin, where its outputs do, and the number of outputs; states follow those of x."""
        states = np.cumsum([len(self.continuous.a), *(len(each.a) for each in self.blocks)])
        outputs = np.cumsum([0, *(len(each.c) for each in self.blocks)])
        return states, outputs, int(outputs[-1])

    @cached_property
    def _times(self) -> list[dict[Fraction, None]]:
        """Instants of each block within a period, ascending."""
        if (total := sum(int(self.period / _fraction(block.sample_time)) for block in self.blocks)) > MOST_INSTANTS:
            times = ", ".join(sorted({f"{block.sample_time:g} s" for block in self.blocks}))
            raise InputError(
                f"the sample times {times} have a common period of {float(self.period):g} s with {total} instants; margins need "
                f"one with at most {MOST_INSTANTS}"
            )
        found = []
        for block in self.blocks:
            step, first = _fraction(block.sample_time), _fraction(block.offset)
            found.append(
                dict.fromkeys(sorted((first + k * step) % self.period for k in range(int(self.period / step))))
            )
        return found

    def _cut(self, late: tuple[Fraction, ...]) -> LiftedLoop:
        """The cut loop with torques that reach the robot late, each by less than a sample time of its block [s].

        The state is [x, states of blocks, outputs of blocks, torques of channels].
        """
        if late in self._cuts:
            return self._cuts[late]
        states, _, count = self._layout
        outputs = int(states[-1])
        torques = outputs + count
        size = torques + len(self.channels)
        # instants: samples, then the torques of channels; those that wrap around the period are of the period before
        sent = [[at + each for at in self._times[k]] for each, k in zip(late, self.owners, strict=True)]
        waiting = tuple(sum(at >= self.period for at in instants) for instants in sent)
        happening = {(at, -1) for instants in self._times for at in instants}
        happening |= {(at % self.period, i) for i, instants in enumerate(sent) for at in instants}
        # from [state, fed torques] to the state, instant after instant
        begins = np.cumsum([0, *map(len, sent)])
        whole, found = np.eye(size, size + int(begins[-1])), np.zeros((int(begins[-1]), size + int(begins[-1])))
        fed, read, now = begins[:-1].copy(), begins[:-1].copy(), Fraction(0)
        for at, i in sorted(happening):
            whole, now = self._flow(at - now) @ whole, at
            if i >= 0:
                whole[torques + i] = 0.0
                whole[torques + i, size + fed[i]] = 1.0
                fed[i] += 1
                continue
            due = frozenset(k for k, instants in enumerate(self._times) if at in instants)
            if due not in self._samples:
                self._samples[due] = np.eye(size)
                self._sample(self._samples[due], due)
            whole = self._samples[due] @ whole
            for j, k in enumerate(self.owners):
                if k in due:
                    found[read[j]] = whole[outputs + self.channels[j]]
                    read[j] += 1
        whole = self._flow(self.period - now) @ whole
        times = tuple((i, float(at)) for i, k in enumerate(self.owners) for at in self._times[k])
        loop = LiftedLoop(
            whole[:, :size], whole[:, size:], found[:, :size], found[:, size:], times, float(self.period), waiting
        )
        # without the states that nothing reaches and those that reach nothing: what is overwritten within a period
        while not (kept := (loop.a.any(0) | loop.c.any(0)) & (loop.a.any(1) | loop.b.any(1))).all():
            loop = replace(loop, a=loop.a[np.ix_(kept, kept)], b=loop.b[kept], c=loop.c[:, kept])
        self._cuts[late] = loop
        return loop

    def _flow(self, time: Fraction) -> RealArray:
        """The flow of the continuous states over a time, of which there are few different ones."""
        if time not in self._flows:
            states, _, count = self._layout
            n, outputs, x = len(self.continuous.a), int(states[-1]), self.continuous
            matrix = np.zeros((outputs + count + len(self.channels),) * 2)
            matrix[:n, :n] = x.a
            matrix[:n, outputs : outputs + count] = x.held[0]
            matrix[:n, outputs + count :] = x.channels[0]
            self._flows[time] = expm(matrix * float(time)) if time else np.eye(len(matrix))
        return self._flows[time]

    def _sample(self, whole: RealArray, due: frozenset[int]) -> None:
        """Outputs of the blocks that are due, in the order of calls, then their next states."""
        states, outputs, count = self._layout
        first_output, x = int(states[-1]), self.continuous
        torques = first_output + count
        signals = x.c @ whole[: len(x.a)] + x.channels[1] @ whole[torques:]

        def taken(k: int) -> RealArray:
            held = whole[first_output:torques]
            return np.asarray(self.inputs[k] @ np.vstack([signals + x.held[1] @ held, held]))

        for k in self.calls:
            if k in due:
                block, own = self.blocks[k], slice(int(states[k]), int(states[k + 1]))
                out = slice(first_output + int(outputs[k]), first_output + int(outputs[k + 1]))
                whole[out] = block.c @ whole[own] + block.d @ taken(k)
        after = {k: self.blocks[k].b @ taken(k) for k in due}
        for k, inputs in after.items():
            own = slice(int(states[k]), int(states[k + 1]))
            whole[own] = self.blocks[k].a @ whole[own] + inputs


@dataclass(frozen=True, eq=False)
class LiftedLoop:
    """A loop that is cut at channels, lifted over a period: x' = A x + B u, y = C x + D u from what is fed in (p,) to what comes back (p,).

    Attributes:
        a, b, c, d: of the lifted system.
        times: channel and instant [s] of each of the p elements, channel after channel.
        period: [s].
        waiting: for each channel the number of elements at the beginning of a period that came back in the one before.
    """

    a: RealArray
    b: RealArray
    c: RealArray
    d: RealArray
    times: tuple[tuple[int, float], ...]
    period: float
    waiting: tuple[int, ...]

    @property
    def size(self) -> int:
        """p."""
        return len(self.times)

    @cached_property
    def of(self) -> NDArray[np.intp]:
        """The channel of each element, (p,), counted from 0."""
        return np.unique([i for i, _ in self.times], return_inverse=True)[1]

    def closed(self, factors: ArrayLike, late: Sequence[int] = ()) -> NDArray[Any]:
        """Matrices A + B K (I - D K)^-1 C of the closed loop with factors K of the channels, (..., channels).

        Args:
            factors: of each channel.
            late: number of samples by which each channel is late; they wait in a queue, whose elements follow x.
        """
        k = np.asarray(factors)[..., self.of]
        d, b = self.d * k[..., np.newaxis, :], self.b * k[..., np.newaxis, :]
        ahead = np.array(self.waiting) + (np.array(late, int) if len(late) else 0)
        if not ahead.any():
            return np.asarray(self.a + b @ np.linalg.solve(np.eye(self.size) - d, self.c))
        # in each channel the elements that wait, then those that come back: the first ones are fed, the last ones wait then
        fed = np.zeros((self.size, int(ahead.sum()) + self.size))
        kept = np.zeros((int(ahead.sum()), fed.shape[1]))
        queue = 0
        for channel, waiting in enumerate(ahead.tolist()):
            own = np.flatnonzero(self.of == channel)
            line = np.concatenate([np.arange(queue, queue + waiting), ahead.sum() + own]).astype(int)
            fed[own, line[: len(own)]] = 1.0
            kept[np.arange(queue, queue + waiting), line[len(own) :]] = 1.0
            queue += waiting
        by_queue, by_output = fed[:, :queue], fed[:, queue:]
        known = np.concatenate([np.broadcast_to(self.c, (*d.shape[:-2], *self.c.shape)), d @ by_queue], axis=-1)
        back = np.linalg.solve(np.eye(self.size) - d @ by_output, known)
        rest = np.zeros((self.size, len(self.a) + queue))
        rest[:, len(self.a) :] = by_queue
        states = b @ (by_output @ back + rest)
        states[..., : len(self.a)] += self.a
        waits = kept[:, queue:] @ back
        waits[..., len(self.a) :] += kept[:, :queue]
        return np.concatenate([states, waits], axis=-2)

    def part(self, channels: Sequence[int]) -> LiftedLoop:
        """The loop that is cut at some channels only, and closed at the others."""
        inside = np.isin([i for i, _ in self.times], channels)
        cut, others = np.flatnonzero(inside), np.flatnonzero(~inside)
        back = np.linalg.solve(
            np.eye(len(others)) - self.d[np.ix_(others, others)],
            np.hstack([self.c[others], self.d[np.ix_(others, cut)]]),
        )
        n = len(self.a)
        through = np.vstack([self.b[:, others], self.d[np.ix_(cut, others)]]) @ back
        return LiftedLoop(
            self.a + through[:n, :n], self.b[:, cut] + through[:n, n:],
            self.c[cut] + through[n:, :n], self.d[np.ix_(cut, cut)] + through[n:, n:],
            tuple(self.times[i] for i in cut), self.period, (0,) * len(channels),
        )  # fmt: skip

    @cached_property
    def sensitivity(self) -> LiftedLoop:
        """(I + L)^-1: what remains of what is added to the torques."""
        direct = np.linalg.inv(np.eye(self.size) - self.d)
        b, c = self.b @ direct, direct @ self.c
        return LiftedLoop(self.a + self.b @ c, b, c, np.asarray(direct, float), self.times, self.period, self.waiting)

    @cached_property
    def _schur(self) -> tuple[ComplexArray, ComplexArray]:
        """Upper triangular T and unitary Z with A = Z T Z*."""
        t, z = schur(self.a, output="complex")
        return t, z

    def transfer(self, z: ComplexArray, inputs: ComplexArray | None = None) -> ComplexArray:
        """C (z - A)^-1 B + D at points z (N,), times inputs (N, p, m), (N, p, m); without inputs the whole matrices."""
        t, unitary = self._schur
        b, c = unitary.conj().T @ self.b, self.c @ unitary
        x = np.empty((len(t), len(z), self.size if inputs is None else inputs.shape[-1]), dtype=complex)
        x[:] = b[:, np.newaxis] if inputs is None else (b @ inputs).swapaxes(0, 1)
        # back substitution, at all points at once; a point on a pole is beside it
        for k in reversed(range(len(t))):
            inside = z - t[k, k]
            x[k] /= np.where(inside == 0.0, TINY, inside)[:, np.newaxis]
            x[:k] += t[:k, k, np.newaxis, np.newaxis] * x[k]
        found = np.tensordot(c, x, 1).swapaxes(0, 1)
        return np.asarray(found + (self.d if inputs is None else self.d @ inputs))

    def fundamental(self, frequency: RealArray) -> ComplexArray:
        """The part of the loop transfer functions that keeps the frequency, for negative feedback, (N, channels, channels).

        Args:
            frequency: (N,) angular frequencies [rad/s].
        """
        instants = np.array([t for _, t in self.times])
        turned = np.exp(1j * frequency[:, np.newaxis] * instants)[:, :, np.newaxis]
        inputs = turned * np.eye(int(self.of.max()) + 1)[self.of]
        share = inputs / np.bincount(self.of)
        lifted = self.transfer(np.exp(1j * frequency * self.period), inputs)
        return np.asarray(-share.conj().swapaxes(1, 2) @ lifted)


def open_loop(a: RealArray, b: RealArray, c: RealArray, d: RealArray, step: float | None) -> LiftedLoop:
    """The loop that a system alone is, x' = A x + B u continuous, or from inputs that are held for a step [s] to outputs at its ends."""
    n, m = b.shape
    if step is not None:
        held = expm(step * np.block([[a, b], [np.zeros((m, n + m))]]))
        a, b = held[:n, :n], held[:n, n:]
    return LiftedLoop(a, b, c, d, tuple((i, 0.0) for i in range(m)), step or 0.0, ())


@lru_cache(maxsize=4096)
def _fraction(time: float) -> Fraction:
    return Fraction(time).limit_denominator(FINEST)
