"""Disturbances of the robot: forces at the end effector, torques on the motors, and masses that are picked up and dropped.

Each is a block without inputs, whose output is called like the input of the robot that it acts on. What is constant between
instants is sampled at these instants alone, so that they are exact and cost a communication point each; sines, noise and files
are held from sample to sample. What all share: ``signal`` is the output, ``force.x``, ``force.y`` [N], ``joint1.disturbance`` [N.m],
``payload.change`` [kg] and so on, which has the unit of the values; ``sample_time`` is the time between samples [s], ``start`` the first
sample [s], ``duration`` the time from there on after which the signal is zero [s], None for no end; ``name`` is the block's name.

Raises:
    InputError: a value isn't finite, or the sample time isn't positive.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from hashlib import sha256
from itertools import pairwise
from math import ceil, inf, isfinite, pi, sqrt
from typing import Required, TypedDict, Unpack

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Equations, Vector, block, rows_in_turn
from flexfmu.cosim.control.controllers.named_signals import unit_of
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray, check_sampling
from flexfmu.fmu_build.regular_sampling import exact
from flexfmu.model.scene.disturbances import (
    PAYLOAD,
    BandNoiseSection,
    CsvSection,
    PayloadChangeSection,
    PulseSection,
    SampledDisturbanceSection,
    SineSection,
    StepSection,
)
from flexfmu.model.symbolic import SymbolicBlock, Variable
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.table_file import read_signal


class SampleTimes(TypedDict, total=False):
    """What all sampled disturbances take beside their own arguments, see above."""

    sample_time: Required[float]
    start: float
    duration: float | None
    name: str


def steps(signal: str, instants: Sequence[float], values: Sequence[float], name: str = "step") -> SymbolicBlock:
    """Build the block: zero, then each of the values from its instant on, exactly.

    Args:
        instants: ascending [s], as many as values.
        values: each is a tunable parameter, ``amplitude`` or ``amplitude[1]`` ...
    """
    _check_finite(name, "the instants [s]", instants)
    _check_finite(name, "the values", values)
    if len(instants) != len(values) or not values or any(b <= a for a, b in pairwise(instants)) or instants[0] < 0.0:
        raise InputError(f"{name}: give ascending instants from 0 s on and as many values, got {list(instants)} s")
    # a sample of zero comes before the first instant, unless that is the start
    times = [float(exact(each)) for each in instants]
    before = [0.0] if times[0] > 0.0 else []

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # the state counts the samples
        value = casadi.SX(0.0)
        for k in range(len(times)):
            value = casadi.if_else(x >= k + len(before), p[k], value)
        return value, x + 1.0

    several = len(values) > 1
    parameters = [
        Variable(
            f"amplitude[{k}]" if several else "amplitude",
            unit_of(signal),
            f"Value from {at!r} s on",
            "parameter",
            value,
        )
        for k, (at, value) in enumerate(zip(instants, values, strict=True), start=1)
    ]
    return _source(name, "Disturbance in steps", signal, equations, inf, 0.0, parameters, instants=(*before, *times))


def sine(
    signal: str,
    amplitude: float,
    frequency: float,
    *,
    phase: float = 0.0,
    **timing: Unpack[SampleTimes],
) -> SymbolicBlock:
    """Build the block: amplitude sin(2 pi frequency (t - start) + phase), held between the samples.

    Amplitude, frequency [Hz] and phase [rad] are tunable parameters.
    """
    _check_finite(timing.get("name", "sine"), "amplitude, frequency and phase", (amplitude, frequency, phase))
    parameters = [
        Variable("amplitude", unit_of(signal), "Amplitude", "parameter", amplitude),
        Variable("frequency", "Hz", "Frequency", "parameter", frequency),
        Variable("phase", "rad", "Phase at the start", "parameter", phase),
    ]

    def law(t: Vector, p: Vector) -> Vector:
        return p[0] * casadi.sin(2.0 * pi * p[1] * t + p[2])

    return _sampled("sine", "Sine disturbance", signal, law, parameters, **timing)


def band_noise(
    signal: str,
    standard_deviation: float,
    band: tuple[float, float],
    seed: int = 0,
    *,
    components: int = 50,
    **timing: Unpack[SampleTimes],
) -> SymbolicBlock:
    """Build the block: a sum of n sines with amplitudes sqrt(2/n) standard_deviation and random phases, held between samples.

    Their frequencies are the middles of n equal parts of the band. The spectral density is constant within the band and
    zero beyond, the values are nearly normal, and the mean square over a period, 2 n / (width of the band), is exactly that of
    the standard deviation if 2 n low / width is a whole number (M. Shinozuka, G. Deodatis, Simulation of stochastic
    processes by spectral representation, Applied Mechanics Reviews 44(4), 1991, section 3).

    Args:
        standard_deviation: a tunable parameter.
        band: lowest and highest frequency [Hz], ascending, below half the sampling frequency.
        seed: the phases depend on it, on the name of the block and on the signal.
        components: n.
    """
    (low, high), name, h = band, timing.get("name", "noise"), timing["sample_time"]
    _check_finite(name, "standard deviation and band", (standard_deviation, low, high))
    if not 0.0 <= low < high or components < 1:
        raise InputError(
            f"{name}: the band must ascend from 0 Hz or more, with one component at least, got {list(band)} Hz"
        )
    if high * h > 0.5:
        raise InputError(
            f"{name}: the band reaches {high:g} Hz, above half the sampling frequency, {0.5 / h:g} Hz: reduce it, or "
            f"the sample_time of {h:g} s"
        )
    rates = 2.0 * pi * (low + (high - low) * (np.arange(components) + 0.5) / components)
    # random phases that depend on the text alone
    digests = [sha256(f"{seed}/{name}/{signal}/{k}".encode()).digest() for k in range(components)]
    phases = [2.0 * pi * int.from_bytes(each[:6], "big") / 2**48 for each in digests]
    parameters = [
        Variable("standard_deviation", unit_of(signal), "Standard deviation", "parameter", standard_deviation, 0.0)
    ]

    def law(t: Vector, p: Vector) -> Vector:
        terms = [casadi.sin(rate * t + phase) for rate, phase in zip(rates.tolist(), phases, strict=True)]
        return sqrt(2.0 / components) * p[0] * casadi.sum1(casadi.vertcat(*terms))

    return _sampled("noise", "Band-limited noise", signal, law, parameters, **timing)


def table(signal: str, times: RealArray, values: RealArray, **timing: Unpack[SampleTimes]) -> SymbolicBlock:
    """Build the block: values (N,) at times (N,) [s] from the start on, linear between, held between samples, zero outside.

    The times ascend from 0 s on.
    """
    name, h, duration = timing.get("name", "csv"), timing["sample_time"], timing.get("duration")
    _check_finite(name, "times and values", (*times, *values))
    if times.shape != values.shape or not times.size or (np.diff(times) <= 0.0).any() or times[0] < 0.0:
        raise InputError(f"{name}: times must ascend from 0 s on, with a value each")
    # the values of all samples, then zero for ever
    offset, first = _clock(name, h, timing.get("start", 0.0))
    count = int(times[-1] / h * (1.0 + 1e-12)) + 1
    if duration is not None:
        count = min(count, _samples(duration, h))
    instants, near = h * np.arange(count), 1e-9 * h
    inside = (instants >= times[0] - near) & (instants <= times[-1] + near)
    sampled = np.where(inside, np.interp(instants, times, values), 0.0)
    rows = np.concatenate([np.zeros(first), sampled, np.zeros(1)])[:, None]
    equations = rows_in_turn(rows, "values")
    return _source(name, "Disturbance from a table", signal, equations, h, offset, symbol=casadi.MX)


def _source(
    name: str,
    description: str,
    signal: str,
    equations: Equations,
    sample_time: float,
    offset: float,
    parameters: Sequence[Variable] = (),
    symbol: object = casadi.SX,
    instants: Sequence[float] = (),
) -> SymbolicBlock:
    """A block without inputs, from a state that counts samples."""
    return block(
        name,
        description,
        equations,
        sample_time=sample_time,
        offset=offset,
        instants=instants,
        inputs=(),
        outputs=[Variable(signal, unit_of(signal), description, "output")],
        parameters=parameters,
        states=(0.0,),
        symbol=symbol,
    )


def _clock(name: str, sample_time: float, start: float) -> tuple[float, int]:
    """Offset [s] and number of the first sample that counts: one of zero comes before a start after 0 s.

    Raises:
        InputError: the start is before the first sample.
    """
    check_sampling(sample_time, start, name)
    if 0.0 < start < sample_time:
        raise InputError(
            f"{name}: the start of {start:g} s must be 0 s, or the sample_time of {sample_time:g} s at least"
        )
    return (float(exact(start) - exact(sample_time)), 1) if start else (0.0, 0)


def _sampled(
    kind: str,
    description: str,
    signal: str,
    law: Callable[[Vector, Vector], Vector],
    parameters: Sequence[Variable],
    *,
    sample_time: float,
    start: float = 0.0,
    duration: float | None = None,
    name: str = "",
) -> SymbolicBlock:
    """A block of a law (time since the start, parameters) → value, until the end of the duration."""
    offset, first = _clock(name or kind, sample_time, start)

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        k = x - first
        acts = k >= 0.0 if duration is None else casadi.logic_and(k >= 0.0, k < _samples(duration, sample_time))
        return casadi.if_else(acts, law(k * sample_time, p), 0.0), x + 1.0

    return _source(name or kind, description, signal, equations, sample_time, offset, parameters)


def _samples(duration: float, sample_time: float) -> int:
    """Number of samples before the end of a duration [s]."""
    return ceil(duration / sample_time * (1.0 - 1e-12))


def _check_finite(name: str, what: str, values: Sequence[float]) -> None:
    """Raise `InputError` if a value is NaN or infinite."""
    for value in values:
        if not isfinite(value):
            raise InputError(f"{name}: {what} must be finite, got {value}")


def _pulse(signal: str, value: float, start: float, end: float | None, name: str) -> SymbolicBlock:
    """A step, back to zero at an end [s]."""
    return steps(signal, [start], [value], name) if end is None else steps(signal, [start, end], [value, 0.0], name)


def _held(s: SampledDisturbanceSection, context: LoopContext) -> SampleTimes:
    """Times and name of a disturbance that is held from sample to sample."""
    h = s.sample_time or context.sample_time
    return SampleTimes(sample_time=h, start=s.start, duration=s.duration, name=context.name)


def _from_step(section: PulseSection | StepSection, context: LoopContext) -> SymbolicBlock:
    end = None if section.duration is None else section.start + section.duration
    return _pulse(section.signal, section.amplitude, section.start, end, context.name)


builds(StepSection)(_from_step)
builds(PulseSection)(_from_step)


@builds(PayloadChangeSection)
def _from_payload(section: PayloadChangeSection, context: LoopContext) -> SymbolicBlock:
    if section.picked_up is None:
        mass = section.mass or context.scene.payload.mass
        return steps(PAYLOAD, [section.dropped or 0.0], [-mass], context.name)
    return _pulse(PAYLOAD, section.mass or 0.0, section.picked_up, section.dropped, context.name)


builds(SineSection)(lambda s, c: sine(s.signal, s.amplitude, s.frequency, phase=s.phase, **_held(s, c)))
builds(BandNoiseSection)(
    lambda s, c: band_noise(s.signal, s.standard_deviation, s.band, s.seed, components=s.components, **_held(s, c))
)


@builds(CsvSection)
def _from_csv(section: CsvSection, context: LoopContext) -> SymbolicBlock:
    # scaled values may be in any unit
    unit = unit_of(section.signal) if section.scale == 1.0 else ""
    try:
        times, values = read_signal(section.file, section.column or section.signal, unit)
    except TrajectoryError as error:
        raise InputError(f"[[disturbance]] csv: {error}") from None
    return table(section.signal, times, section.scale * values, **_held(section, context))
