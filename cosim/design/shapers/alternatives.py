"""Designs input shapers for a scene from the robot's vibration modes along the path and over a payload band."""

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
from flexfmu.trajectories.shapers.designs import SHAPERS, design, specified_insensitivity
from flexfmu.trajectories.shapers.sequence import ImpulseSequence, Oscillator

POSES = 11
"""Number of poses at which the modes are calculated: at equal intervals of time along the path, both ends included."""

NEIGHBOURHOOD = 3.0
"""Shapers are designed for modes up to this multiple of the lowest frequency; a motion hardly excites higher ones."""

MOST_MODES = 3
"""Largest number of modes that a shaper is designed for; a zero-vibration shaper adds half a period for each."""

WIDEST = 2.2
"""Largest ratio of the highest to the lowest frequency of a specified-insensitivity shaper's band."""

CONVOLVED = ("um-zv", "zv", "zvd")
"""Shapers that are convolved for several modes; longer ones would add too much time."""


@dataclass(frozen=True)
class DesignModes:
    """The modes and frequency bands that the shapers are designed for.

    Attributes:
        modes: modes at the end pose, where the residual vibration occurs, with the scene's payload; lowest first.
        path_range: lowest and highest frequency of the first mode along the path [Hz].
        band: lowest frequency of the first and highest of the last mode at the end pose over the payload band [Hz].
        first_band: lowest and highest frequency of the first mode at the end pose over the payload band [Hz].
    """

    modes: tuple[Oscillator, ...]
    path_range: tuple[float, float]
    band: tuple[float, float]
    first_band: tuple[float, float]


@dataclass(frozen=True)
class Alternative:
    """A shaper designed for the scene.

    Attributes:
        name: short name.
        sequence: its impulses.
        section: its keys in the scene file's `[[shaper]]` table, without `apply`.
    """

    name: str
    sequence: ImpulseSequence
    section: Mapping[str, Any] = field(default_factory=dict)


def design_modes(motion: MotionPlan, payload_errors: Iterable[float]) -> DesignModes:
    """Return the modes at the end of a motion, and their frequency bands along the path and over the payload errors.

    Args:
        motion: a scene's motion.
        payload_errors: relative errors of the payload's mass.

    Raises:
        InputError: nothing vibrates.
        EquilibriumError: the robot has no stable equilibrium at a pose.
    """
    # modes along the path, and at the end pose with each payload error
    poses = motion.joints.evaluate(np.linspace(0.0, motion.duration, POSES), 0)[0]
    found = [damped_modes(motion.scene, pose) for pose in poses]
    modes = tuple(_relevant(found[-1], motion.scene))
    varied = [damped_modes(with_payload_error(motion.scene, error), poses[-1]) for error in payload_errors]
    ends = [found[-1], *varied]
    # frequency bands
    last = len(modes) - 1
    first = [float(each.frequencies[0]) for each in ends]
    highest = max(float(each.frequencies[min(last, len(each.frequencies) - 1)]) for each in ends)
    along = [float(each.frequencies[0]) for each in found if len(each.frequencies)]
    return DesignModes(modes, (min(along), max(along)), (min(first), highest), (min(first), max(first)))


def _relevant(modes: DampedModes, scene: Scene) -> list[Oscillator]:
    """Return the lowest modes, at most `MOST_MODES` within `NEIGHBOURHOOD` of the lowest frequency.

    Raises:
        InputError: nothing vibrates.
    """
    if not len(modes.frequencies):
        raise InputError(
            f"nothing vibrates in scene {scene.name}: all links are rigid or overdamped, and there is nothing to shape for; "
            "give `effects` some modes, such as proximal_bending = 3"
        )
    near = modes.frequencies <= NEIGHBOURHOOD * modes.frequencies[0]
    pairs = zip(modes.frequencies[near][:MOST_MODES], modes.ratios[near][:MOST_MODES], strict=True)
    return [Oscillator(float(frequency), float(ratio)) for frequency, ratio in pairs]


def alternatives(design_for: DesignModes) -> list[Alternative]:
    """Return shapers for the first mode, `CONVOLVED` ones for all modes, and SI for the frequency band, by duration.

    SI covers all modes, or where their band is wider than `WIDEST` the first mode alone. A shaper that doesn't exist
    for a mode's damping is left out.
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
