"""Says where a run has left the theory that its model rests on: links that deflect little against their lengths."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from flexfmu.cosim.scene_run import Run

LARGEST_DEFLECTION = 0.1
"""Tip deflection relative to the length up to which linear bending is right within 1 %: a cantilever under a force at its
tip bends 0.7 % less than linear theory says there, and its tip comes 0.6 % of the length nearer to the base."""

LARGEST_ELONGATION = 0.01
"""Elongation relative to the length; no structural metal stretches as far without yielding."""


def exceeded(run: Run) -> list[str]:
    """A sentence for each kind of link that deflects or stretches beyond this."""
    return [*_exceeding(run, "tip_deflection", LARGEST_DEFLECTION), *_exceeding(run, "elongation", LARGEST_ELONGATION)]


def _exceeding(run: Run, kind: str, limit: float) -> Iterator[str]:
    mechanism = run.robot.mechanism
    for name, column in run.recording.columns.items():
        link, _, signal = name.partition(".")
        if signal != kind or not column.values.size:
            continue
        length = (mechanism.proximal if link.endswith("1") else mechanism.distal).length
        largest = float(np.abs(column.values).max())
        if largest > limit * length:
            yield (
                f"{name} reaches {largest:.3g} m, {100.0 * largest / length:.3g} % of the link's length: linear beam theory "
                f"holds up to {100.0 * limit:g} %, beyond it the numbers describe no real link; stiffen or relieve the links"
            )
