"""The shapers that suit a scene: designed from the robot's vibration modes along the path and over a payload band."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexfmu.cosim.control.imperfections.payload_error import with_payload_error
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.model.modes import DampedModes, damped_modes
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.shapers.catalogue import SHAPERS, design
from flexfmu.trajectories.shapers.sequence import ImpulseSequence, Oscillator
from flexfmu.trajectories.shapers.specified_insensitivity import specified_insensitivity

POSES = 11
"""Poses along the path at which the modes are looked at, by equal fractions of time, both ends included."""

NEIGHBOURHOOD = 3.0
"""Modes up to this multiple of the lowest frequency are shaped for; a pick-and-place motion hardly excites higher ones."""

MOST_MODES = 3
"""Modes that are shaped for at most; each costs half a period of its own at least."""

WIDEST = 2.2
"""Largest ratio of the highest to the lowest frequency that one specified-insensitivity shaper has to cover."""

CONVOLVED = ("um-zv", "zv", "zvd")
"""Shapers that are convolved for several modes; the longer ones would cost more than they bring."""


@dataclass(frozen=True)
class DesignModes:
    """What the shapers are designed for.

    Attributes:
        modes: the modes at the end pose with the scene's payload, where the residual vibration is; lowest first.
        path_range: lowest and highest frequency of the first mode along the path [Hz].
        band: lowest frequency of the first and highest of the last mode at the end pose over the payload band [Hz].
        first_band: the same of the first mode alone [Hz].
    """

    modes: tuple[Oscillator, ...]
    path_range: tuple[float, float]
    band: tuple[float, float]
    first_band: tuple[float, float]


@dataclass(frozen=True)
class Alternative:
    """A shaper that could be used.

    Attributes:
        name: short name.
        sequence: its impulses.
        section: the keys of the scene file's `[[shaper]]` that make it, but for `apply`.
    """

    name: str
    sequence: ImpulseSequence
    section: Mapping[str, Any] = field(default_factory=dict)


def design_modes(motion: MotionPlan, payload_errors: Iterable[float]) -> DesignModes:
    """The modes that matter at the end of a motion, and how far they move along the path and with the payload.

    Args:
        motion: a scene's motion.
        payload_errors: relative errors of the payload's mass.

    Raises:
        InputError: nothing vibrates.
        EquilibriumError: the robot has no stable equilibrium at a pose.
    """
    poses = motion.joints.evaluate(np.linspace(0.0, motion.duration, POSES), 0)[0]
    found = [damped_modes(motion.scene, pose) for pose in poses]
    modes = tuple(_relevant(found[-1], motion.scene))
    varied = [damped_modes(with_payload_error(motion.scene, error), poses[-1]) for error in payload_errors]
    ends = [found[-1], *varied]
    last = len(modes) - 1
    first = [float(each.frequencies[0]) for each in ends]
    highest = max(float(each.frequencies[min(last, len(each.frequencies) - 1)]) for each in ends)
    along = [float(each.frequencies[0]) for each in found if len(each.frequencies)]
    return DesignModes(modes, (min(along), max(along)), (min(first), highest), (min(first), max(first)))


def _relevant(modes: DampedModes, scene: Scene) -> list[Oscillator]:
    """The lowest modes that are near to each other."""
    if not len(modes.frequencies):
        raise InputError(
            f"nothing vibrates in scene {scene.name}: all links are rigid or overdamped, and there is nothing to shape for; "
            "give `effects` some modes, such as proximal_bending = 3"
        )
    near = modes.frequencies <= NEIGHBOURHOOD * modes.frequencies[0]
    pairs = zip(modes.frequencies[near][:MOST_MODES], modes.ratios[near][:MOST_MODES], strict=True)
    return [Oscillator(float(frequency), float(ratio)) for frequency, ratio in pairs]


def alternatives(design_for: DesignModes) -> list[Alternative]:
    """All shapers for the first mode, for all modes together by convolution, and SI for the whole band; shortest first.

    A shaper that doesn't exist for a mode's damping is left out.
    """
    modes = design_for.modes
    candidates = [(name, modes[:1]) for name in SHAPERS]
    if len(modes) > 1:
        candidates += [(name, modes) for name in CONVOLVED]
    found = []
    for name, chosen in candidates:
        with suppress(TrajectoryError):  # too much damping for this kind
            section = {"kind": name, "modes": [{"frequency": each.frequency, "ratio": each.ratio} for each in chosen]}
            found.append(Alternative(" x ".join([name] * len(chosen)), design(name, chosen), section))
    band = design_for.band if design_for.band[1] <= WIDEST * design_for.band[0] else design_for.first_band
    with suppress(TrajectoryError):  # the band is too wide
        insensitive = {"kind": "si", "band": list(band), "ratio": modes[0].ratio}
        found.append(Alternative("si", specified_insensitivity(*band, ratio=modes[0].ratio), insensitive))
    return sorted(found, key=lambda each: each.sequence.duration)
