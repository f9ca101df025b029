"""Natural frequencies along the Lamé path: centre and half range, as the paper states them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.paper.cases import case_scene
from flexfmu.cosim.paper.comparison import Evaluate
from flexfmu.cosim.planning import plan
from flexfmu.model.modes import natural_frequencies

POSES = 41
"""Poses along the path, start, middle and end included."""

ROWS: Mapping[str, tuple[str, int]] = {
    "first, 6 kg": ("barnard2012-6kg", 0),
    "first, 0.1 kg": ("barnard2012-0.1kg", 0),
    "third, 0.1 kg": ("barnard2012-0.1kg", 2),
}
"""Row of the comparison → scene, and index of the frequency in ascending order."""


def frequencies_along_path(scene_name: str) -> NDArray[np.float64]:
    """Natural frequencies [Hz], ascending, at `POSES` poses of the Lamé path, (poses, n)."""
    scene = case_scene(scene_name, "7th order polynomial", "Lamé")
    joints = plan(scene).joints
    poses = joints.evaluate(np.linspace(0.0, joints.duration, POSES), order=0)[0]
    return np.stack([natural_frequencies(scene, pose) for pose in poses])


def evaluators() -> Mapping[str, Evaluate]:
    """The metric of the frequencies' comparison → function of row and column."""
    frequencies = {name: frequencies_along_path(name) for name, _ in ROWS.values()}

    def evaluate(row: str, column: str) -> float:
        name, index = ROWS[row]
        lowest, highest = frequencies[name][:, index].min(), frequencies[name][:, index].max()
        return float({"centre": highest + lowest, "half range": highest - lowest}[column] / 2)

    return {"natural_frequency": evaluate}
