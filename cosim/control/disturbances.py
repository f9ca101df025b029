"""Disturbances of the robot: forces at the end effector, torques on the motors, and masses that are picked up and dropped.

Each is a block without inputs, whose output is called like the input of the robot that it acts on. What is constant between
instants is sampled at these instants alone, so that they are exact; sines, noise and files are held from sample to sample.
Several that act on one signal add up in one more block, at the instants of all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import reduce
from hashlib import sha256
from itertools import pairwise
from math import ceil, gcd, isfinite, lcm, pi, sqrt

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray, Slave, check_sampling
from flexfmu.model.scene.disturbances import PAYLOAD
from flexfmu.model.symbolic import SymbolicBlock, Variable

IDLE = Fraction(1)
"""Sample time of a block whose output doesn't change [s]."""

SHORTEST = 1e-6
"""Shortest sample time of a sum or of several instants [s]; a shorter one suggests instants that differ by mistake."""


def steps(signal: str, instants: Sequence[float], values: Sequence[float], name: str = "step") -> SymbolicBlock:
    """Build the block: zero, then each of the values from its instant on, exactly.

    Args:
        signal: output; ``force.x``, ``force.y`` [N], ``joint1.disturbance`` [N.m], ``payload.change`` [kg] ...
        instants: ascending [s].
        values: in the signal's unit; each is a tunable parameter, ``amplitude`` or ``amplitude[1]`` ...
        name: name of the block.

    Raises:
        InputError: instants and values differ in number, don't ascend or aren't finite, or have no common step of 1 µs or more.
    """
    _check_finite(name, "the instants [s]", instants)
    _check_finite(name, "the values", values)
    if len(instants) != len(values) or not values or any(b <= a for a, b in pairwise(instants)) or instants[0] < 0.0:
        raise InputError(f"{name}: give ascending instants from 0 s on and as many values, got {list(instants)} s")
    # a step that leads from instant to instant; a sample of zero comes before the first one, unless that is the start
    times = [_exact(each) for each in instants]
    apart = [each - times[0] for each in times[1:]]
    step = _common(apart or times, name)
    if 0 < times[0] < step:
        step = _common([*apart, times[0]], name)
    offset = max(times[0] - step, Fraction(0))
    counts = [int((each - offset) / step) for each in times]

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # the state counts the samples, up to the last instant
        value = casadi.SX(0.0)
        for k, count in enumerate(counts):
            value = casadi.if_else(x >= count, p[k], value)
        return value, casadi.fmin(x + 1.0, float(counts[-1]))

    several = len(values) > 1
    parameters = [
        Variable(
            f"amplitude[{k}]" if several else "amplitude", _unit(signal), f"Value from {at!r} s on", "parameter", value
        )
        for k, (at, value) in enumerate(zip(instants, values, strict=True), start=1)
    ]
    return _source(name, "Disturbance in steps", signal, equations, float(step), float(offset), parameters)


def sine(
    signal: str,
    amplitude: float,
    frequency: float,
    *,
    sample_time: float,
    phase: float = 0.0,
    start: float = 0.0,
    duration: float | None = None,
    name: str = "sine",
) -> SymbolicBlock:
    """Build the block: amplitude sin(2 pi frequency (t - start) + phase), held between the samples.

    Args:
        signal: as for `steps`.
        amplitude: in the signal's unit; tunable, as are frequency [Hz] and phase [rad].
        sample_time, start: time between samples and first sample [s].
        duration: time from the start on after which it is zero [s]; None for no end.
        name: name of the block.

    Raises:
        InputError: a value isn't finite, or the sample time isn't positive.
    """
    _check_finite(name, "amplitude, frequency and phase", (amplitude, frequency, phase))
    parameters = [
        Variable("amplitude", _unit(signal), "Amplitude", "parameter", amplitude),
        Variable("frequency", "Hz", "Frequency", "parameter", frequency),
        Variable("phase", "rad", "Phase at the start", "parameter", phase),
    ]

    def law(t: Vector, p: Vector) -> Vector:
        return p[0] * casadi.sin(2.0 * pi * p[1] * t + p[2])

    return _sampled(name, "Sine disturbance", signal, law, sample_time, start, duration, parameters)


def band_noise(
    signal: str,
    standard_deviation: float,
    band: tuple[float, float],
    seed: int = 0,
    *,
    sample_time: float,
    components: int = 50,
    start: float = 0.0,
    duration: float | None = None,
    name: str = "noise",
) -> SymbolicBlock:
    """Build the block: a sum of n sines with amplitudes sqrt(2/n) standard_deviation and random phases, held between samples.

    Their frequencies are the middles of n equal parts of the band. The spectral density is constant within the band and
    zero beyond, the values are nearly normal, and the mean square over a period, 2 n / (width of the band), is exactly that of
    the standard deviation if 2 n low / width is a whole number (M. Shinozuka, G. Deodatis, Simulation of stochastic
    processes by spectral representation, Applied Mechanics Reviews 44(4), 1991, section 3).

    Args:
        signal: as for `steps`.
        standard_deviation: in the signal's unit; tunable.
        band: lowest and highest frequency [Hz], below half the sampling frequency.
        seed: the phases depend on it, on the name of the block and on the signal.
        sample_time, start, duration: as for `sine`.
        components: n.
        name: name of the block.

    Raises:
        InputError: the band doesn't ascend or reaches half the sampling frequency, or a value isn't finite.
    """
    low, high = band
    _check_finite(name, "standard deviation and band", (standard_deviation, low, high))
    if not 0.0 <= low < high or components < 1:
        raise InputError(
            f"{name}: the band must ascend from 0 Hz or more, with one component at least, got {list(band)} Hz"
        )
    if high * sample_time > 0.5:
        raise InputError(
            f"{name}: the band reaches {high:g} Hz, above half the sampling frequency, {0.5 / sample_time:g} Hz: reduce it, or "
            f"the sample_time of {sample_time:g} s"
        )
    rates = 2.0 * pi * (low + (high - low) * (np.arange(components) + 0.5) / components)
    phases = [_phase(f"{seed}/{name}/{signal}/{k}") for k in range(components)]
    parameters = [
        Variable("standard_deviation", _unit(signal), "Standard deviation", "parameter", standard_deviation, 0.0)
    ]

    def law(t: Vector, p: Vector) -> Vector:
        terms = [casadi.sin(rate * t + phase) for rate, phase in zip(rates.tolist(), phases, strict=True)]
        return sqrt(2.0 / components) * p[0] * casadi.sum1(casadi.vertcat(*terms))

    return _sampled(name, "Band-limited noise", signal, law, sample_time, start, duration, parameters)


def table(
    signal: str,
    times: RealArray,
    values: RealArray,
    *,
    sample_time: float,
    start: float = 0.0,
    duration: float | None = None,
    name: str = "csv",
) -> SymbolicBlock:
    """Build the block: values (N,) at times (N,) [s] from the start on, linear between, held between samples, zero outside.

    Args:
        signal: as for `steps`.
        times: ascending.
        values: in the signal's unit.
        sample_time, start, duration: as for `sine`.
        name: name of the block.

    Raises:
        InputError: times don't ascend, or a value isn't finite.
    """
    _check_finite(name, "times and values", (*times, *values))
    if times.shape != values.shape or not times.size or (np.diff(times) <= 0.0).any() or times[0] < 0.0:
        raise InputError(f"{name}: times must ascend from 0 s on, with a value each")
    # the values of all samples, then zero for ever
    check_sampling(sample_time, start, name)
    count = int(times[-1] / sample_time * (1.0 + 1e-12)) + 1
    if duration is not None:
        count = min(count, _samples(duration, sample_time))
    instants = sample_time * np.arange(count)
    near = 1e-9 * sample_time
    inside = (instants >= times[0] - near) & (instants <= times[-1] + near)
    sampled = np.where(inside, np.interp(instants, times, values), 0.0)
    offset, first = _clock(name, sample_time, start)
    nodes = np.concatenate([np.zeros(first), sampled, np.zeros(2)])
    read = casadi.interpolant("values", "linear", [np.arange(float(nodes.size))], nodes)

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        return read(x), casadi.fmin(x + 1.0, float(first + count))

    return _source(name, "Disturbance from a table", signal, equations, sample_time, offset, symbol=casadi.MX)


def disturbance_sum(
    signal: str, sources: Sequence[str], *, sample_time: float, name: str = "disturbance_sum"
) -> SymbolicBlock:
    """Build the block: the sum of a signal of several slaves, with inputs ``slave.signal``.

    Raises:
        InputError: the sample time isn't positive.
    """
    unit = _unit(signal)
    return block(
        name,
        "Sum of disturbances",
        lambda x, u, p: (casadi.sum1(u), x),
        sample_time=sample_time,
        inputs=[Variable(f"{each}.{signal}", unit, f"Term from {each}", "input", 0.0) for each in sources],
        outputs=[Variable(signal, unit, "Sum of all terms", "output")],
    )


def with_sums(disturbances: Sequence[Slave], unused: Callable[[str], str]) -> list[Slave]:
    """The disturbances, and a sum for each signal of several, at the common step of all of their instants.

    Args:
        disturbances: the slaves.
        unused: assigns a unique name.

    Raises:
        InputError: disturbances that add up aren't blocks, or their instants have no common step of 1 µs or more.
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
        clocks: list[Fraction] = []
        for each in slaves:
            if not isinstance(each, BlockSlave):
                raise InputError(f"{each.name} and another slave output {signal}: only blocks add up, leave one out")
            clocks += [_exact(each.offset), _exact(each.sample_time)]
        step = float(_common(clocks, f"disturbances in {signal}"))
        names = [each.name for each in slaves]
        sums.append(BlockSlave(disturbance_sum(signal, names, sample_time=step, name=unused("disturbance_sum"))))
    return [*disturbances, *sums]


def _source(
    name: str,
    description: str,
    signal: str,
    equations: Callable[[Vector, Vector, Vector], tuple[Vector, Vector]],
    sample_time: float,
    offset: float,
    parameters: Sequence[Variable] = (),
    symbol: object = casadi.SX,
) -> SymbolicBlock:
    """A block without inputs, from a state that counts samples."""
    return block(
        name,
        description,
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=(),
        outputs=[Variable(signal, _unit(signal), description, "output")],
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
    return (float(_exact(start) - _exact(sample_time)), 1) if start else (0.0, 0)


def _sampled(
    name: str,
    description: str,
    signal: str,
    law: Callable[[Vector, Vector], Vector],
    sample_time: float,
    start: float,
    duration: float | None,
    parameters: Sequence[Variable],
) -> SymbolicBlock:
    """A block of a law (time since the start, parameters) → value, until the end of the duration."""
    offset, first = _clock(name, sample_time, start)

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        k = x - first
        acts = k >= 0.0 if duration is None else casadi.logic_and(k >= 0.0, k < _samples(duration, sample_time))
        return casadi.if_else(acts, law(k * sample_time, p), 0.0), x + 1.0

    return _source(name, description, signal, equations, sample_time, offset, parameters)


def _samples(duration: float, sample_time: float) -> int:
    """Number of samples before the end of a duration [s]."""
    return ceil(duration / sample_time * (1.0 - 1e-12))


def _exact(value: float) -> Fraction:
    """The number that a user writes, not the nearest binary one: to 1e-12 s."""
    return Fraction(repr(round(float(value), 12)))


def _common(times: Sequence[Fraction], where: str) -> Fraction:
    """The longest time of which all are multiples.

    Raises:
        InputError: it is below `SHORTEST`.
    """
    positive = [each for each in times if each] or [IDLE]
    denominator = lcm(*(each.denominator for each in positive))
    step = Fraction(reduce(gcd, (int(each * denominator) for each in positive)), denominator)
    if step < Fraction(SHORTEST):
        listed = ", ".join(f"{float(each):g}" for each in positive)
        raise InputError(f"{where}: the times {listed} s have no common step of 1 µs or more: round them")
    return step


def _phase(key: str) -> float:
    """A random phase [rad] that depends on the text alone."""
    return 2.0 * pi * int.from_bytes(sha256(key.encode()).digest()[:6], "big") / 2**48


def _unit(signal: str) -> str:
    """Unit of an input of the robot."""
    return "N" if signal.startswith("force.") else "kg" if signal == PAYLOAD else "N.m"


def _check_finite(name: str, what: str, values: Sequence[float]) -> None:
    """Raise `InputError` if a value is NaN or infinite."""
    for value in values:
        if not isfinite(value):
            raise InputError(f"{name}: {what} must be finite, got {value}")
