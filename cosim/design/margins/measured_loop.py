"""A sampled loop around a plant of which a measured frequency response is known, with its margins.

The lifted response of the cut loop is the model's, exactly, and what measured and modelled plant differ by at each frequency that a held torque
contains, the aliases too: so sample times, holds, delays and lags count as for a model, and outside of the response's band the model
counts. Whether the loop is stable follows from encirclements: those of det(I - M), relative to the model's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, gcd, inf, lcm, nan, pi

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.design.margins.linear_blocks import LinearBlock
from flexfmu.cosim.design.margins.linear_loop import FINEST, ComplexArray, Continuous, LiftedLoop, LinearLoop, open_loop
from flexfmu.cosim.design.margins.loci import loop_figures, margins_with_errors, refined
from flexfmu.cosim.design.margins.margins import FIGURES, LoopMargins, OpenLoop, PoseMargins, frequencies_of
from flexfmu.cosim.design.margins.scene_loop import WiredSystem
from flexfmu.cosim.design.response.response import FrequencyResponse
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.contract import LinearPlant
from flexfmu.model.linear import signal_label
from flexfmu.trajectories.jets import RealArray

DELAY = FIGURES.index("delay_margin")

END = 1e-9
"""Relative error of a frequency that is half that of the period."""

WHOLE = 1e-6
"""Largest distance of a sample time from a multiple of the response's, relative to the latter."""


Alias = tuple[NDArray[np.intp], RealArray, ComplexArray, ComplexArray]
"""Indices of frequencies (M,), angular frequencies there [rad/s], from the p elements to the plant's inputs, from its outputs to the elements."""


class MeasuredLoop:
    """A loop of a model with the measured response in place of the plant's.

    Args:
        loop: the loop, linearised around the model of the plant.
        channels: names of its channels.
        wired: the slaves that it is of.
        plant: the model.
        response: the plant's response.

    Attributes:
        response: the response.
        fed: channel and instant [s] of each of the p elements that are fed in a period.
        period: [s].

    Raises:
        InputError: the response lacks a signal of the loop, or its inputs aren't held for a share of the loop's sample times.
    """

    def __init__(
        self,
        loop: LinearLoop,
        channels: Sequence[str],
        wired: WiredSystem,
        plant: LinearPlant,
        response: FrequencyResponse,
    ) -> None:
        self._loop, self._plant, self.response = loop, plant, response
        self._paths = wired.signal_paths()
        self._outputs = [*dict.fromkeys(name for name, _ in self._paths if name)]
        self._inputs = [*channels]
        self._late = [wired.through_lags((wired.plant, name))[1] for name in channels]
        self._picked = self._matched()
        step = response.sample_time
        for each in [] if step is None else [loop.blocks[k].sample_time / step for k in loop.owners]:
            if abs(each - round(each)) > WHOLE or each < 0.5:
                raise InputError(
                    f"the response is that of inputs held for {1e3 * (step or 0.0):g} ms, which the loop's sample time is {each:g} times: "
                    "estimate a continuous one, or at the loop's sample time"
                )
        probed, self._instants = self._with_probes()
        self._lifted, self.period = probed.lifted, float(loop.period)
        self.fed = [each for each in self._lifted.times if each[0] < len(channels)]
        self._model = self._own_response()
        self._known: tuple[RealArray, ComplexArray, list[Alias]] | None = None

    def _matched(self) -> list[tuple[int, int]]:
        """For each of the plant's outputs its place in the response, and how often it is differentiated there."""
        given, inputs = (
            [signal_label(each) for each in names] for names in (self.response.outputs, self.response.inputs)
        )
        found = []
        for full in self._outputs:
            name = signal_label(full)
            position = name.replace("_velocity", "_position")
            if name not in given and (position not in given or self.response.sample_time is not None):
                more = ": its derivative can't be told from values at samples" if position in given else ""
                has = ", ".join(self.response.outputs)
                raise InputError(f"the loop takes {full}, which the response lacks{more}; it has {has}")
            found.append((given.index(name), 0) if name in given else (given.index(position), 1))
        for full in self._inputs:
            if signal_label(full) not in inputs:
                has = ", ".join(self.response.inputs)
                raise InputError(f"the loop feeds {full}, which the response lacks; it has the inputs {has}")
        self._columns = [inputs.index(signal_label(each)) for each in self._inputs]
        return found

    def _own_response(self) -> LiftedLoop:
        """The model between the same signals, continuous or held for a sample as the response is."""
        plant, step = self._plant, self.response.sample_time
        rows, columns = [*map(plant.outputs.index, self._outputs)], [*map(plant.inputs.index, self._inputs)]
        return open_loop(plant.a, plant.b[:, columns], plant.c[rows], plant.d[np.ix_(rows, columns)], step)

    def _with_probes(self) -> tuple[LinearLoop, RealArray]:
        """The loop with further channels that add to each signal, and the instants [s] at which what they add is read.

        A block beside the loop holds what they add from between two instants on, at which others sample, to the next ones.
        """
        loop, x = self._loop, self._loop.continuous
        instants = [each for block in loop.blocks for each in (block.sample_time, block.offset)]
        times = [Fraction(each).limit_denominator(FINEST) for each in instants]
        parts = lcm(*(each.denominator for each in times))
        step = Fraction(gcd(*(int(each * parts) for each in times)), parts)
        n, signals, outputs = len(x.a), len(x.c), x.held[0].shape[1]
        none = np.zeros((n, signals)), np.zeros((signals, signals))
        held = (np.hstack([x.held[0], none[0]]), np.hstack([x.held[1], none[1]]))
        channels = (np.hstack([x.channels[0], none[0]]), np.hstack([x.channels[1], np.eye(signals)]))
        empty = np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((signals, 0)), np.zeros((signals, 0))
        probe = LinearBlock(*empty, float(step), float(step / 2))
        inputs = [np.hstack([each, np.zeros((len(each), signals))]) for each in loop.inputs]
        probed = LinearLoop(
            Continuous(x.a, x.c, held, channels), (*loop.blocks, probe), (*loop.calls, len(loop.blocks)),
            (*inputs, np.zeros((0, signals + outputs + signals))), (*loop.channels, *range(outputs, outputs + signals)),
        )  # fmt: skip
        return probed, np.asarray(np.arange(1, int(loop.period / step) + 1) * float(step), float)

    def matrices(self, omega: RealArray, draws: ComplexArray | None = None) -> ComplexArray:
        """M (N, p, p) at angular frequencies (N,) [rad/s], with the response's own values or others of the same sizes."""
        # what the response doesn't change is kept for draws of it at the same frequencies
        if self._known is None or self._known[0] is not omega:
            self._known = omega, *self._parts(omega)
        found, aliases = self._known[1].copy(), self._known[2]
        for inside, w, before, after in aliases:
            values = self.response.at(np.abs(w) / (2.0 * pi), draws)[:, :, self._columns]
            values = np.where((w < 0.0)[:, np.newaxis, np.newaxis], values.conj(), values)
            measured = np.stack([values[:, k] * (1j * w[:, np.newaxis]) ** order for k, order in self._picked], axis=1)
            found[inside] += after @ measured @ before
        return found

    def _parts(self, omega: RealArray) -> tuple[ComplexArray, list[Alias]]:
        """M without the plant's response in its band, and the aliases that this adds."""
        p, n, z = len(self.fed), len(omega), np.exp(1j * omega * self.period)
        signals, instants = len(self._paths), len(self._instants)
        whole = self._lifted.transfer(z)[:, :p]
        found, probes = np.array(whole[:, :, :p]), whole[:, :, p:].reshape(n, p, signals, instants)
        low, high = 2.0 * pi * self.response.frequency[[0, -1]] * (1.0 + np.array([-END, END]))
        step = self.response.sample_time
        lowest = inf if step is None else (1.0 - END) * pi / step
        turn, aliases = 2.0 * pi / self.period, list[Alias]()
        for k in range(-ceil(high / turn) - 1, ceil(high / turn) + 1):
            w = omega + k * turn
            # held values repeat themselves: half of their frequency counts once
            inside = np.flatnonzero((np.abs(w) >= low) & (np.abs(w) <= high) & (w > -lowest))
            if not inside.size:
                continue
            w = w[inside]
            # what comes back of each output, through lags to the signals that are sampled
            turned = np.einsum("npsi,ni->nps", probes[inside], np.exp(1j * w[:, np.newaxis] * self._instants))
            after = np.zeros((len(w), p, len(self._outputs)), complex)
            for s, (name, times) in enumerate(self._paths):
                if name:
                    after[:, :, self._outputs.index(name)] += turned[:, :, s] * _lag(w, times)[:, np.newaxis]
            before = self._held(w)
            at = np.asarray(1j * w if step is None else np.exp(1j * w * step), complex)
            found[inside] -= after @ self._model.transfer(at) @ before
            aliases.append((inside, w, before, after))
        return found, aliases

    def _held(self, w: RealArray) -> ComplexArray:
        """Components (M, channels, p) at angular frequencies of the plant's inputs that elements of a period hold."""
        found, step = np.zeros((len(w), len(self._inputs), len(self.fed)), complex), self.response.sample_time
        base = 1j * w if step is None else (1.0 - np.exp(-1j * w * step)) / step
        for element, (channel, at) in enumerate(self.fed):
            length = self._loop.blocks[self._loop.owners[channel]].sample_time
            held = (1.0 - np.exp(-1j * w * length)) / (base * self.period)
            found[:, channel, element] = _lag(w, self._late[channel]) * np.exp(-1j * w * at) * held
        return found

    def frequencies(self) -> RealArray:
        """Angular frequencies [rad/s] up to half that of the samples, more of them about the model's poles."""
        top = pi / min(self._loop.blocks[k].sample_time for k in self._loop.owners)
        return np.append(frequencies_of(self._loop), top)

    def unstable_poles(self, omega: RealArray) -> int:
        """Number of unstable poles of the closed loop, by encirclements along frequencies (N,) [rad/s] up to half that of the period."""
        top = pi / self.period
        omega = np.append(omega[omega < (1.0 - END) * top], top)
        matrices = self.matrices(omega)
        own = self._loop.lifted
        model = own.transfer(np.exp(1j * omega * self.period))
        eye = np.eye(matrices.shape[-1])
        ratio = np.linalg.det(eye - matrices) / np.linalg.det(eye - model)
        turns = np.angle(ratio[1:] / ratio[:-1]).sum() + np.angle(ratio[0])
        closed = np.abs(np.linalg.eigvals(own.closed([1.0] * len(self._inputs))))
        return int((closed > 1.0).sum()) - round(float(turns) / pi)


def _lag(w: RealArray, times: Sequence[float]) -> ComplexArray:
    """Response of lags in a row with time constants [s]."""
    return np.asarray(np.prod([1.0 / (1.0 + 1j * w * each) for each in times], axis=0) * np.ones(len(w), complex))


@dataclass(frozen=True, eq=False)
class MeasuredCut:
    """A loop with a measured plant that is cut at some channels.

    Attributes:
        loop: the loop.
        channels: indices of the channels.
    """

    loop: MeasuredLoop
    channels: tuple[int, ...]

    @property
    def period(self) -> float:
        """Of the loop [s]."""
        return self.loop.period

    @property
    def size(self) -> int:
        """Number of elements that are fed in a period."""
        return int(self._inside.sum())

    @property
    def _inside(self) -> NDArray[np.bool_]:
        return np.isin([i for i, _ in self.loop.fed], self.channels)

    def matrices(self, omega: RealArray, draws: ComplexArray | None = None) -> ComplexArray:
        """From what is fed in to what comes back, (N, size, size), see `MeasuredLoop.matrices`: closed at all other channels."""
        whole = self.loop.matrices(omega, draws)
        cut, others = np.flatnonzero(self._inside), np.flatnonzero(~self._inside)
        found = whole[:, cut[:, np.newaxis], cut]
        if others.size:
            inside = np.eye(len(others)) - whole[:, others[:, np.newaxis], others]
            back = np.linalg.solve(inside, whole[:, others[:, np.newaxis], cut])
            found = found + whole[:, cut[:, np.newaxis], others] @ back
        # real where z = -1, up to the response's errors
        ends = np.abs(np.exp(1j * omega * self.period) + 1.0) < END
        found[ends] = found[ends].real
        return np.asarray(found)

    def fundamental(self, omega: RealArray, matrices: ComplexArray | None = None) -> ComplexArray:
        """The part that keeps the frequency, for negative feedback, see `LiftedLoop.fundamental`."""
        channels, instants = np.array(self.loop.fed).T[:, self._inside]
        of = np.unique(channels, return_inverse=True)[1]
        turned = np.exp(1j * omega[:, np.newaxis] * instants)[:, :, np.newaxis] * np.eye(len(self.channels))[of]
        found = self.matrices(omega) if matrices is None else matrices
        return np.asarray(-(turned / np.bincount(of)).conj().swapaxes(1, 2) @ found @ turned)

    def margins(
        self, row: LoopMargins, opened: OpenLoop, grid: RealArray, draws: Sequence[ComplexArray]
    ) -> LoopMargins:
        """The margins of the stable loop, by frequencies (N,) [rad/s] and others about them; errors by what keeps the frequency.

        A delay turns what keeps the frequency. How the aliases move its margin is as with the model, by its margins and open loop.
        """
        of, top = np.array([i for i, _ in self.loop.fed])[self._inside], pi / self.period
        omega = refined(self.matrices, of, grid, top)
        found = self.matrices(omega)

        def kept(fundamental: ComplexArray) -> tuple[float, ...]:
            return loop_figures(omega, -fundamental, np.arange(len(self.channels)), fundamental)

        figures = [*loop_figures(omega, found, of, self.fundamental(omega, found), top)]
        own = kept(opened.fundamental(omega))[DELAY]
        if 0.0 < row.delay_margin < inf and own < inf:
            figures[DELAY] *= row.delay_margin / own
        drawn = (kept(self.fundamental(omega, self.matrices(omega, draw))) for draw in draws)
        return margins_with_errors(row.channel, tuple(figures), drawn)


def measured_margins(loop: MeasuredLoop, names: Sequence[str], model: PoseMargins) -> PoseMargins:
    """The margins at a pose with the measured plant, each with its standard error, where those of the model are known.

    Args:
        loop: the loop.
        names: of its channels.
        model: the margins of the model there.
    """
    grid, own = loop.frequencies(), 2.0 * pi * loop.response.frequency
    grid = np.unique(np.concatenate([[0.0], grid, own[own < grid[-1]], [pi / loop.period]]))
    unstable, everything = loop.unstable_poles(grid), tuple(range(len(names)))
    cuts = [MeasuredCut(loop, (i,)) for i in everything] + ([MeasuredCut(loop, everything)] if len(names) > 1 else [])
    # of an unstable loop there are none
    draws = [] if unstable else loop.response.drawn()
    known = zip(cuts, model.loops, model.open, strict=True)
    rows = [cut.margins(row, opened, grid, draws) for cut, row, opened in known]
    if unstable:
        rows = [LoopMargins.of(each.channel, 1.0, 1.0, 0.0, 0.0, 0.0, nan, nan, each.crossover) for each in rows]
    none = np.zeros(0, complex)
    return replace(model, radius=nan, poles=none, loops=tuple(rows), open=tuple(cuts), unstable=unstable)
