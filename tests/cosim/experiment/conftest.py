"""The paper's robot with motors that have an inertia, driven by torques."""

from __future__ import annotations

import pytest

from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

COMPUTED_TORQUE = {"kind": "computed-torque", "proportional": 6400.0, "derivative": 160.0, "sample_time": 1e-3}


@pytest.fixture(scope="session")
def robot() -> Scene:
    """Without motor inertia the joints of flexible links are next to massless at high frequency, and no velocity feedback
    of useful strength is stable at 1 kHz."""
    return load_scene("barnard2012-6kg").replace(
        {"name": "loop", "cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "trajectory.dwell": 0.1}
    )


@pytest.fixture(scope="session")
def controlled(robot: Scene) -> Scene:
    """The same with a computed-torque controller at 1 kHz."""
    return robot.replace({"controller": [COMPUTED_TORQUE]})
