"""The two bases converge to the same robot; static and fixed-interface shapes do so with far fewer coordinates."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import natural_frequencies

POSES = [(-0.175, 0.320), (0.0, 0.295)]
SHIPPED = ("barnard2012-6kg", "barnard2012-0.1kg")
SIX = {
    "effects.basis": "craig-bampton",
    "effects.proximal_bending": 1,
    "effects.distal_bending": 1,
    "effects.distal_axial": 1,
}
"""1 + 1 + 1 shapes for each leg, 6 coordinates; the paper's scene has 3 + 3, 12 coordinates."""


def converged(scene: Scene, basis: str, modes: int) -> Scene:
    """The robot with so many modes of every family."""
    families = {"proximal_bending": modes, "proximal_axial": modes, "distal_bending": modes, "distal_axial": modes}
    return scene.replace({"effects.basis": basis} | {f"effects.{key}": count for key, count in families.items()})


def frequencies(scene: Scene, count: int) -> np.ndarray:
    """The first natural frequencies [Hz] at all poses, shape (poses, count)."""
    poses = [natural_frequencies(scene, motor_angles(scene.mechanism, pose)) for pose in POSES]
    return np.array([found[:count] for found in poses])


@pytest.mark.parametrize("name", SHIPPED)
def test_six_coordinates_beat_the_papers_twelve_in_frequency(name: str) -> None:
    """1 + 1 + 1 static and bending shapes are nearer to the converged robot: 0.15 % instead of up to 1.5 %."""
    scene = load_scene(name)
    reference = frequencies(converged(scene, "craig-bampton", 6), 2)
    six, twelve = (frequencies(each, 2) / reference - 1.0 for each in (scene.replace(SIX), scene))
    assert scene.replace(SIX).effects.proximal_axial == 0
    assert np.all(six > 0.0)
    assert np.abs(six).max() < 1.5e-3
    assert np.abs(twelve).max() > 1.6 * np.abs(six).max()
    assert np.all(np.abs(six[:, 0]) < 0.6 * np.abs(twelve[:, 0]))
