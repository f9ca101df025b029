"""Input shapers of a loop: the impulse sequences of the scene file, and the block for sampled signals.

The block is an FIR filter; an impulse between two samples is split over both, not rounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import check_sampling
from flexfmu.model.scene.shapers import AppliedShaperSection, ImpulseShaperSection, SpecifiedInsensitivitySection
from flexfmu.model.symbolic import SymbolicBlock, Variable
from flexfmu.trajectories.shapers.designs import design, specified_insensitivity
from flexfmu.trajectories.shapers.sequence import ImpulseSequence, Oscillator


@dataclass(frozen=True)
class Shaper:
    """An impulse sequence and the signals that it shapes.

    Attributes:
        sequence: the impulses.
        apply: ``joints`` (the joint references), ``path`` (the motion along the path, which doesn't leave the path), or
            ``sampled`` (a slave shapes the sampled joint references).
        sample_time: of a sampled shaper [s]; None for the others.
        offset: first sample instant of a sampled shaper [s].
        name: name of the slave of a sampled shaper.

    Raises:
        InputError: ``apply`` is unknown, a sampled shaper has no sample time, or another one has one.
    """

    sequence: ImpulseSequence
    apply: str = "joints"
    sample_time: float | None = None
    offset: float = 0.0
    name: str = "shaper"

    def __post_init__(self) -> None:
        if not isinstance(self.sequence, ImpulseSequence):
            raise InputError(f"a shaper needs an ImpulseSequence of times and amplitudes, got {self.sequence!r}")
        if self.apply not in ("joints", "path", "sampled"):
            raise InputError(f"a shaper acts on joints, path or sampled references, got {self.apply!r}")
        if (self.apply == "sampled") != (self.sample_time is not None):
            raise InputError(
                f"sample_time [s] goes with apply='sampled' alone, got {self.sample_time} s, {self.apply!r}"
            )


@builds(ImpulseShaperSection)
def _from_section(section: ImpulseShaperSection, context: LoopContext) -> Shaper:
    """Build a shaper of the catalogue, for the modes of the section or the lowest modes at the end pose."""
    if section.modes is not None:
        modes = [Oscillator(mode.frequency, mode.ratio) for mode in section.modes]
    else:
        from flexfmu.model.statics import damped_modes

        # at the end pose, where the residual vibration occurs
        found = damped_modes(context.scene, context.joints.evaluate(context.joints.duration, 0, "left")[0, 0])
        if len(found.frequencies) < section.mode_count:
            raise InputError(
                f"`shaper.mode_count` = {section.mode_count}, but scene {context.scene.name} has {len(found.frequencies)} modes "
                "that vibrate; take fewer, or name `modes`"
            )
        pairs = list(zip(found.frequencies.tolist(), found.ratios.tolist(), strict=True))
        modes = [Oscillator(*each) for each in pairs[: section.mode_count]]
    return _applied(design(section.kind, modes), section)


@builds(SpecifiedInsensitivitySection)
def _insensitive(section: SpecifiedInsensitivitySection, context: LoopContext) -> Shaper:
    """Build the specified-insensitivity shaper for a band of frequencies."""
    return _applied(specified_insensitivity(*section.band, section.tolerance, section.ratio), section)


def _applied(sequence: ImpulseSequence, section: AppliedShaperSection) -> Shaper:
    """Return the shaper of an impulse sequence, applied as its section says."""
    return Shaper(sequence, section.apply, section.sample_time, section.offset, section.name or "shaper")


LONGEST_LINE = 20_000
"""Largest number of samples in the delay line; more are probably a mistake in the sample time's unit."""

SHAPED = "shaped."
"""Prefix of the outputs' names."""


JOINT_REFERENCES = {
    f"joint{joint}.reference.{kind}": unit
    for kind, unit in (("position", "rad"), ("velocity", "rad/s"), ("acceleration", "rad/s2"))
    for joint in (1, 2)
}
"""Signals that a shaper shapes → unit: position, velocity and acceleration of both joints."""


def shaper_block(
    sequence: ImpulseSequence, sample_time: float, *, offset: float = 0.0, name: str = "shaper"
) -> SymbolicBlock:
    """Build the block y_k = Σ w_i u_{k-i}; the weights w_i are the impulses, split over the samples.

    Inputs are named like the signals, outputs ``shaped.<name>``. Before the first sample the robot rests: positions have their first
    value, velocities and accelerations are zero. The delay line stores each signal's difference from that value, so it starts from
    zero at any start pose.

    Args:
        sequence: impulses.
        sample_time, offset: [s].
        name: name of the block.

    Raises:
        InputError: the sample time or offset is out of range, or the delay line is too long.
    """
    check_sampling(sample_time, offset, name)
    signals, weights = JOINT_REFERENCES, _weights(sequence, sample_time, name)
    length, held = len(weights) - 1, [signal.endswith("position") for signal in signals]

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # difference of each signal from its value before the first sample
        lines, kept, started = casadi.vertsplit(x, [0, length * len(signals), x.numel() - 1, x.numel()])
        first = [value for value, keep in zip(casadi.vertsplit(u), held, strict=True) if keep]
        origins = casadi.if_else(started, kept, casadi.vertcat(casadi.SX(0, 1), *first))
        rows = iter(casadi.vertsplit(origins))
        origin = casadi.vertcat(*(next(rows) if each else casadi.SX(0) for each in held))
        difference = u - origin
        # weighted sum of present and past differences
        window = casadi.vertcat(difference.T, casadi.reshape(lines, length, len(signals)))
        shaped = origin + casadi.mtimes(window.T, casadi.DM(weights))
        return shaped, casadi.vertcat(casadi.vec(window[:-1, :]), origins, 1)

    return block(
        name,
        f"Input shaper with {len(sequence.times)} impulses within {sequence.duration:g} s",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=[Variable(each, unit, f"{each} before shaping", "input", 0.0) for each, unit in signals.items()],
        outputs=[Variable(SHAPED + each, unit, f"{each} after shaping", "output") for each, unit in signals.items()],
        states=np.zeros(length * len(signals) + sum(held) + 1).tolist(),
    )


def _weights(sequence: ImpulseSequence, sample_time: float, name: str) -> list[float]:
    """Return the weight of each sample, the current one first.

    Raises:
        InputError: the delay line is longer than `LONGEST_LINE`.
    """
    if sequence.duration > LONGEST_LINE * sample_time:
        raise InputError(
            f"{name}: a sample time of {sample_time:g} s makes a line of {sequence.duration / sample_time:.3g} samples for "
            f"impulses within {sequence.duration:g} s; at most {LONGEST_LINE} are allowed: choose a larger sample time"
        )
    # an impulse between two samples is split over both
    split = sequence.split(sample_time)
    samples = [round(time / sample_time) for time in split.times]
    weights = np.zeros(samples[-1] + 1)
    weights[samples] = split.amplitudes
    return [float(weight) for weight in weights]
