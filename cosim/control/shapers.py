"""Input shapers of a loop: the impulse sequences of the scene file, and the signals that they shape."""

from __future__ import annotations

from dataclasses import dataclass

from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.shapers import AppliedShaperSection, ImpulseShaperSection, SpecifiedInsensitivitySection
from flexfmu.trajectories.shapers.catalogue import design
from flexfmu.trajectories.shapers.sequence import ImpulseSequence, Oscillator
from flexfmu.trajectories.shapers.specified_insensitivity import specified_insensitivity


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
        if self.apply not in ("joints", "path", "sampled"):
            raise InputError(f"a shaper acts on joints, path or sampled references, got {self.apply!r}")
        if (self.apply == "sampled") != (self.sample_time is not None):
            raise InputError(
                f"sample_time [s] goes with apply='sampled' alone, got {self.sample_time} s, {self.apply!r}"
            )


@builds(ImpulseShaperSection)
def _from_section(section: ImpulseShaperSection, context: LoopContext) -> Shaper:
    """Build a shaper of the catalogue, for the modes of the section or the lowest modes at the end pose."""
    # modes from the scene file
    if section.modes is not None:
        modes = [Oscillator(mode.frequency, mode.ratio) for mode in section.modes]
        return _applied(design(section.kind, modes), section)
    from flexfmu.model.modes import damped_modes

    # modes at the end pose, where the residual vibration occurs
    found = damped_modes(context.scene, context.joints.evaluate(context.joints.duration, 0, "left")[0, 0])
    count = section.mode_count
    if len(found.frequencies) < count:
        raise InputError(
            f"`shaper.mode_count` = {count}, but scene {context.scene.name} has {len(found.frequencies)} modes that vibrate; "
            "take fewer, or name `modes`"
        )
    pairs = zip(found.frequencies[:count], found.ratios[:count], strict=True)
    modes = [Oscillator(float(frequency), float(ratio)) for frequency, ratio in pairs]
    return _applied(design(section.kind, modes), section)


@builds(SpecifiedInsensitivitySection)
def _insensitive(section: SpecifiedInsensitivitySection, context: LoopContext) -> Shaper:
    """Build the specified-insensitivity shaper for a band of frequencies."""
    return _applied(specified_insensitivity(*section.band, section.tolerance, section.ratio), section)


def _applied(sequence: ImpulseSequence, section: AppliedShaperSection) -> Shaper:
    """Return the shaper of an impulse sequence, applied as its section says."""
    return Shaper(sequence, section.apply, section.sample_time, section.offset, section.name or "shaper")
