"""Disturbances of the robot: forces at the end effector, torques on the motors, and masses that are picked up and dropped.

Each is a block without inputs, whose output is called like the input of the robot that it acts on: ``force.x``, ``force.y`` [N],
``joint1.disturbance`` [N.m], ``payload.change`` [kg] and so on. What is constant between instants is sampled at these instants alone, so
that they are exact and cost a communication point each; sines, noise and files are held from sample to sample, from the start of their
section to the end of its duration. Where several act on one signal, or several controllers give a feedforward torque, a block adds them up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from hashlib import sha256
from math import ceil, inf, pi, sqrt

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Equations, Vector, block, rows_in_turn, split
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.joints import unit_of
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import Slave
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.regular_sampling import common_step, exact
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
from flexfmu.trajectories.table import read_signal


def pulse(s: PulseSection | StepSection, context: LoopContext) -> SymbolicBlock:
    """Build the block of a step, or of a pulse where there is a duration."""
    end = {} if s.duration is None else {s.start + s.duration: 0.0}
    return steps(s.signal, {s.start: s.amplitude, **end}, context.name)


builds(StepSection)(pulse)
builds(PulseSection)(pulse)


@builds(PayloadChangeSection)
def payload_change(s: PayloadChangeSection, context: LoopContext) -> SymbolicBlock:
    """Build the block of a mass that is picked up and dropped; dropped alone it is by default all of the robot's payload."""
    if s.picked_up is None:
        return steps(PAYLOAD, {s.dropped or 0.0: -(s.mass or context.scene.payload.mass)}, context.name)
    end = {} if s.dropped is None else {s.dropped: 0.0}
    return steps(PAYLOAD, {s.picked_up: s.mass or 0.0, **end}, context.name)


def steps(signal: str, values: Mapping[float, float], name: str) -> SymbolicBlock:
    """Build the block: zero, then each of the values from its instant [s] on, exactly; instants ascend from 0 s on.

    Each value is a tunable parameter, ``amplitude`` or ``amplitude[1]`` ...
    """
    # a sample of zero comes before the first instant, unless that is the start
    times = [float(exact(each)) for each in values]
    before = [0.0] if times[0] > 0.0 else []

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # the state counts the samples
        value = casadi.SX(0.0)
        for k in range(len(times)):
            value = casadi.if_else(x >= k + len(before), p[k], value)
        return value, x + 1.0

    names = [f"amplitude[{k}]" for k in range(1, len(values) + 1)] if len(values) > 1 else ["amplitude"]
    parameters = [
        Variable(each, unit_of(signal), f"Value from {at!r} s on", "parameter", value)
        for each, (at, value) in zip(names, values.items(), strict=True)
    ]
    title = "Disturbance in steps"
    return _source(name, title, signal, equations, inf, 0.0, parameters, instants=(*before, *times))


@builds(SineSection)
def sine(s: SineSection, context: LoopContext) -> SymbolicBlock:
    """Build the block: amplitude sin(2 pi frequency (t - start) + phase), held between the samples.

    Amplitude, frequency [Hz] and phase [rad] are tunable parameters.
    """
    parameters = [
        Variable("amplitude", unit_of(s.signal), "Amplitude", "parameter", s.amplitude),
        Variable("frequency", "Hz", "Frequency", "parameter", s.frequency),
        Variable("phase", "rad", "Phase at the start", "parameter", s.phase),
    ]

    def law(t: Vector, p: Vector) -> Vector:
        return p[0] * casadi.sin(2.0 * pi * p[1] * t + p[2])

    return _sampled("Sine disturbance", s, context, law, parameters)


@builds(BandNoiseSection)
def band_noise(s: BandNoiseSection, context: LoopContext) -> SymbolicBlock:
    """Build the block: a sum of n sines with amplitudes sqrt(2/n) standard_deviation and random phases, held between samples.

    Their frequencies are the middles of n equal parts of the band. The spectral density is constant within the band and
    zero beyond, the values are nearly normal, and the mean square over a period, 2 n / (width of the band), is exactly that of
    the standard deviation if 2 n low / width is a whole number (M. Shinozuka, G. Deodatis, Simulation of stochastic
    processes by spectral representation, Applied Mechanics Reviews 44(4), 1991, section 3). The phases depend on the seed, on the
    name of the block and on the signal; the standard deviation is a tunable parameter.

    Raises:
        InputError: the band reaches beyond half the sampling frequency.
    """
    (low, high), name, h, n = s.band, context.name, s.sample_time or context.sample_time, s.components
    if high * h > 0.5:
        raise InputError(
            f"{name}: the band reaches {high:g} Hz, above half the sampling frequency, {0.5 / h:g} Hz: reduce it, or "
            f"the sample_time of {h:g} s"
        )
    rates = 2.0 * pi * (low + (high - low) * (np.arange(n) + 0.5) / n)
    # random phases that depend on the text alone
    digests = [sha256(f"{s.seed}/{name}/{s.signal}/{k}".encode()).digest() for k in range(n)]
    phases = [2.0 * pi * int.from_bytes(each[:6], "big") / 2**48 for each in digests]
    parameters = [
        Variable("standard_deviation", unit_of(s.signal), "Standard deviation", "parameter", s.standard_deviation, 0.0)
    ]

    def law(t: Vector, p: Vector) -> Vector:
        terms = [casadi.sin(rate * t + phase) for rate, phase in zip(rates.tolist(), phases, strict=True)]
        return sqrt(2.0 / n) * p[0] * casadi.sum1(casadi.vertcat(*terms))

    return _sampled("Band-limited noise", s, context, law, parameters)


@builds(CsvSection)
def table(s: CsvSection, context: LoopContext) -> SymbolicBlock:
    """Build the block of a column of a file: linear between its rows, held between samples, zero outside.

    Raises:
        InputError: the file can't be read, its times don't ascend from 0 s on, or it begins before the first sample.
    """
    # scaled values may be in any unit
    try:
        times, values = read_signal(s.file, s.column or s.signal, unit_of(s.signal) if s.scale == 1.0 else "")
    except TrajectoryError as error:
        raise InputError(f"[[disturbance]] csv: {error}") from None
    name, h = context.name, s.sample_time or context.sample_time
    if not times.size or (np.diff(times) <= 0.0).any() or times[0] < 0.0:
        raise InputError(f"{name}: times must ascend from 0 s on, with a value each")
    # the values of all samples, then zero for ever
    offset, first = _clock(name, h, s.start)
    count = int(times[-1] / h * (1.0 + 1e-12)) + 1
    if s.duration is not None:
        count = min(count, _samples(s.duration, h))
    instants, near = h * np.arange(count), 1e-9 * h
    inside = (instants >= times[0] - near) & (instants <= times[-1] + near)
    sampled = np.where(inside, np.interp(instants, times, s.scale * values), 0.0)
    rows = np.concatenate([np.zeros(first), sampled, np.zeros(1)])[:, None]
    title = "Disturbance from a table"
    return _source(name, title, s.signal, rows_in_turn(rows, "values"), h, offset, symbol=casadi.MX)


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
    if 0.0 < start < sample_time:
        raise InputError(
            f"{name}: the start of {start:g} s must be 0 s, or the sample_time of {sample_time:g} s at least"
        )
    return (float(exact(start) - exact(sample_time)), 1) if start else (0.0, 0)


def _sampled(
    title: str,
    s: SampledDisturbanceSection,
    context: LoopContext,
    law: Callable[[Vector, Vector], Vector],
    parameters: Sequence[Variable],
) -> SymbolicBlock:
    """A block of a law (time since the start, parameters) → value, until the end of the duration."""
    sample_time, duration = s.sample_time or context.sample_time, s.duration
    offset, first = _clock(context.name, sample_time, s.start)

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        k = x - first
        acts = k >= 0.0 if duration is None else casadi.logic_and(k >= 0.0, k < _samples(duration, sample_time))
        return casadi.if_else(acts, law(k * sample_time, p), 0.0), x + 1.0

    return _source(context.name, title, s.signal, equations, sample_time, offset, parameters)


def _samples(duration: float, sample_time: float) -> int:
    """Number of samples before the end of a duration [s]."""
    return ceil(duration / sample_time * (1.0 - 1e-12))


def sum_block(
    name: str,
    description: str,
    sources: Mapping[str, Sequence[str]],
    *,
    sample_time: float,
    offset: float = 0.0,
    instants: Sequence[float] = (),
) -> SymbolicBlock:
    """Build the block: each output is the sum of the same output of several slaves, without states.

    Inputs are called like the outputs that they take, ``feedforward.joint1.feedforward``; an output is ``joint1.feedforward``.

    Args:
        name, description, sample_time, offset, instants: as for `block`.
        sources: output → names of the slaves that have it.
    """
    signals = [(output, slave) for output, slaves in sources.items() for slave in slaves]
    sizes = [len(slaves) for slaves in sources.values()]
    return block(
        name,
        description,
        lambda x, u, p: (casadi.vertcat(*(casadi.sum1(each) for each in split(u, *sizes))), x),
        sample_time=sample_time,
        offset=offset,
        instants=instants,
        inputs=[
            Variable(f"{who}.{what}", unit_of(what), f"Term of {what} from {who}", "input", 0.0)
            for what, who in signals
        ],
        outputs=[Variable(each, unit_of(each), f"Sum of {each} of several slaves", "output") for each in sources],
    )


def with_sums(disturbances: Sequence[Slave], unused: Callable[[str], str]) -> list[Slave]:
    """The disturbances, and a sum for each signal of several: at the common step of their samples and at all of their instants.

    Args:
        disturbances: the slaves.
        unused: assigns a unique name.

    Raises:
        InputError: disturbances that add up aren't blocks, or their samples have no common step of 1 µs or more.
    """
    owners: dict[str, list[Slave]] = {}
    for each in disturbances:
        for variable in each.variables:
            if variable.causality == "output":
                owners.setdefault(variable.name, []).append(each)
    sums = []
    for signal, slaves in owners.items():
        if len(slaves) == 1:
            continue
        clocks, instants = list[Fraction](), set[float]()
        for each in slaves:
            if not isinstance(each, BlockSlave):
                raise InputError(f"{each.name} and another slave output {signal}: only blocks add up, leave one out")
            instants.update(each.instants)
            if each.sample_time < inf:
                clocks += [exact(each.offset), exact(each.sample_time)]
        try:
            step = float(common_step(clocks, f"disturbances in {signal}")) if clocks else inf
        except ModelError as error:
            raise InputError(str(error)) from None
        sources, name = {signal: [each.name for each in slaves]}, unused("disturbance_sum")
        total = sum_block(name, "Sum of disturbances", sources, sample_time=step, instants=sorted(instants))
        sums.append(BlockSlave(total))
    return [*disturbances, *sums]
