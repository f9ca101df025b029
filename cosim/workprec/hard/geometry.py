"""The mechanism's closure and branch, recomputed from what the FMU puts out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.results import Recording
from flexfmu.cosim.workprec.hard.reference import POSITION
from flexfmu.model.assembly import bases
from flexfmu.model.scene import Mechanism

Array = NDArray[np.float64]


LOOP_SIGNALS = (
    *POSITION,
    *(f"joint{leg}.reference.position" for leg in (1, 2)),
    *(f"link{leg}1.tip_deflection" for leg in (1, 2)),
    *(f"link{leg}2.elongation" for leg in (1, 2)),
)
"""What the closure is recomputed from; without deflections, links are rigid."""


@dataclass(frozen=True)
class LoopGeometry:
    """The closed loop at N instants.

    Attributes:
        residual: (N,) largest distance by which a distal link fails to reach from its elbow to the end effector [m].
        sine: (N,) of the angle between the distal links, positive on the assembly side of the mechanism.
    """

    residual: Array
    sine: Array


def loop_geometry(mechanism: Mechanism, recording: Recording) -> LoopGeometry:
    """From joint references, deflections and end effector, for links that bend next to the bases and stretch beyond the
    elbows, if at all."""
    tip = np.stack([recording[name].values for name in POSITION], axis=1)
    arms, residuals = [], []
    for leg, base in zip((1, 2), bases(mechanism), strict=True):
        angle = recording[f"joint{leg}.reference.position"].values
        along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        sag = _deflection(recording, f"link{leg}1.tip_deflection")[:, None]
        arm = tip - (np.asarray(base) + mechanism.proximal.length * along + sag * across)
        length = mechanism.distal.length + _deflection(recording, f"link{leg}2.elongation")
        residuals.append(abs(np.linalg.norm(arm, axis=1) - length))
        arms.append(arm / length[:, None])
    (x1, y1), (x2, y2) = arms[0].T, arms[1].T
    side = 1.0 if mechanism.assembly_mode == "left" else -1.0
    return LoopGeometry(np.max(residuals, axis=0), side * (x1 * y2 - y1 * x2))


def _deflection(recording: Recording, name: str) -> Array:
    """(N,) [m]; zero for a rigid link."""
    return recording[name].values if name in recording.columns else np.zeros(recording.time.size)
