"""Input shapers of a loop: impulse sequences from the scene file, and where they act."""

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
    """An impulse sequence and where it acts.

    Attributes:
        sequence: the impulses.
        apply: ``joints`` (the joint references), ``path`` (the motion along the path, which keeps the path), or
            ``sampled`` (a slave that shapes the sampled joint references).
        sample_time: [s] of a sampled shaper; None for the others.
        offset: its first sample [s].
        name: name of its slave.

    Raises:
        InputError: a sampled shaper has no sample time, or another one has.
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
    """A shaper of the catalogue, for the modes of the section or the lowest ones at the end pose."""
    if section.modes is not None:
        modes = [Oscillator(mode.frequency, mode.ratio) for mode in section.modes]
        return _applied(design(section.kind, modes), section)
    from flexfmu.model.modes import damped_modes

    # residual vibration is that of the end pose
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
    """The shortest shaper for a band of frequencies."""
    return _applied(specified_insensitivity(*section.band, section.tolerance, section.ratio), section)


def _applied(sequence: ImpulseSequence, section: AppliedShaperSection) -> Shaper:
    """The impulses with the place where the section applies them."""
    return Shaper(sequence, section.apply, section.sample_time, section.offset, section.name or "shaper")
