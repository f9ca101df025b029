"""A robot for references that follow a motion exactly."""

from __future__ import annotations

import pytest

from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene


@pytest.fixture(scope="session")
def robot() -> Scene:
    """One bending mode for each proximal link; little damping, so that nothing is forgiven."""
    few = {"effects.proximal_bending": 1, "effects.distal_axial": 0, "effects.damping.ratio": 0.01}
    return load_scene("barnard2012-6kg").replace(few)
