"""Shapers by the names that scene files and tables use."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import reduce

from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.shapers.extra_insensitive import extra_insensitive
from flexfmu.trajectories.shapers.sequence import ImpulseSequence, Oscillator
from flexfmu.trajectories.shapers.zero_vibration import modified_zero_vibration, unity_magnitude, zero_vibration

SHAPERS: Mapping[str, Callable[[Oscillator], ImpulseSequence]] = {
    "um-zv": unity_magnitude,
    "zv": zero_vibration,
    "mzv": modified_zero_vibration,
    "zvd": lambda mode: zero_vibration(mode, 1),
    "ei": lambda mode: extra_insensitive(mode, humps=1),
    "zvdd": lambda mode: zero_vibration(mode, 2),
    "2-hump-ei": lambda mode: extra_insensitive(mode, humps=2),
    "zvddd": lambda mode: zero_vibration(mode, 3),
    "3-hump-ei": lambda mode: extra_insensitive(mode, humps=3),
}
"""Name → shaper for one mode, the shortest first; the tolerance of EI shapers is 5 %."""


def design(name: str, modes: Sequence[Oscillator]) -> ImpulseSequence:
    """Design a shaper of the catalogue; for several modes, the sequences for each mode are convolved.

    Args:
        name: key of `SHAPERS`.
        modes: vibration modes to suppress, at least one.

    Raises:
        TrajectoryError: the name isn't in the catalogue, there is no mode, or no such shaper exists for a mode.
    """
    if name not in SHAPERS:
        raise TrajectoryError(f"shaper must be one of {', '.join(SHAPERS)}; got {name!r}")
    if not modes:
        raise TrajectoryError(f"shaper {name} needs at least one vibration mode to act against")
    return reduce(ImpulseSequence.convolve, (SHAPERS[name](mode) for mode in modes))
