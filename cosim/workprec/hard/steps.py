"""Communication steps of extreme length, and references that jump from one to the next."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.workprec.hard.case import Check, Finding, HardCase
from flexfmu.cosim.workprec.hard.held import HeldRun, start_references
from flexfmu.cosim.workprec.hard.judging import ERROR, NOT_FINITE
from flexfmu.cosim.workprec.hard.robots import ALLOWED

Array = NDArray[np.float64]

TINY, TINY_STEPS = 1e-9, 10_000
"""Length [s] and number of the shortest steps."""

JUMP = 0.02
"""Of joint angles [rad]: no motor turns that far in no time."""

ACCELERATION = 200.0
"""Of joints [rad/s2], that comes and goes at once."""


def cases() -> Iterator[HardCase]:
    """1 ns, 1 s, jumps."""
    tiny = f"{TINY_STEPS} steps: links bend by 0.5 nm; 1 ns is 2e-5 of the shortest period"
    huge = "18 800 periods of the fastest mode in one communication step"
    jumps = f"joint angles jump by {1e3 * JUMP:g} mrad, accelerations by {ACCELERATION:g} rad/s2, in steps of 1 ms that know no derivatives"
    yield HardCase("steps of 1 ns", tiny, partial(_run, tiny_steps))
    yield HardCase("a step of 1 s", huge, partial(_run, huge_step))
    yield HardCase("inputs that jump", jumps, partial(_run, jumping_inputs))


def tiny_steps() -> HeldRun:
    """Straight links begin to bend under the weight."""
    times = TINY * np.arange(TINY_STEPS + 1, dtype=np.float64)
    return HeldRun(times, np.tile(start_references(), (TINY_STEPS, 1)))


def huge_step() -> HeldRun:
    """Free vibration under the weight."""
    return HeldRun(np.array([0.0, 1.0]), start_references()[np.newaxis])


def jumping_inputs() -> HeldRun:
    """Angles jump forth and back, then accelerations, in steps of 1 ms."""
    references = np.tile(start_references(), (60, 1))
    references[10:30, :2] += JUMP, -JUMP
    references[20:40, 4:] += ACCELERATION, -ACCELERATION
    return HeldRun(1e-3 * np.arange(61, dtype=np.float64), references)


def _run(make: Callable[[], HeldRun]) -> Finding:
    """Against SciPy, each signal relative to its own range."""
    run = make()
    found = run.outputs()
    size = float(np.abs(found[:, 2:]).max())
    expected = run.reference(size)
    error = float((np.abs(found - expected)[:, 2:].max(axis=0) / np.abs(expected[:, 2:]).max(axis=0)).max())
    position = float(np.abs(found - expected)[:, :2].max()) / size
    bent = f"all of {len(found)} made; links bend by up to {size:.2g} m"
    checks = (
        Check(f"{ERROR} (DOP853)", error, ALLOWED),
        Check("error of the end effector", position, ALLOWED),
        Check(NOT_FINITE, float(np.count_nonzero(~np.isfinite(found))), 0.0),
    )
    return Finding(bent, checks)
