"""Parameters of FMUs and keys of scenes are the same numbers under two names."""

from __future__ import annotations

from typing import Any

import pytest

from flexfmu.cosim.experiment.parameters import scene_parameters, scene_with_parameters
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

DAMPING: dict[str, dict[str, Any]] = {
    "damping.ratio": {"kind": "modal", "ratio": 0.01},
    "damping.rate": {"kind": "mass", "rate": 2.0},
    "damping.time": {"kind": "stiffness", "time": 1e-4},
}
"""Parameter → the section that has it."""


def complete(damping: str) -> Scene:
    """A scene in which everything has a value."""
    changes = {
        "effects.motor_inertia": 0.1,
        "effects.joint_friction": {"viscous": 0.2, "coulomb": 0.3},
        "effects.transmission": {"stiffness": 1e5, "damping": 2.0},
        "effects.gravity": [0.5, -9.81],
        "effects.damping": DAMPING[damping],
        "payload.inertia": 0.01,
    }
    return load_scene("barnard2012-6kg").replace(changes)


@pytest.mark.parametrize("name", sorted(scene_parameters(complete("damping.ratio"))))
def test_a_changed_parameter_is_that_of_the_robot(name: str) -> None:
    """Metrics are taken from the robot that was simulated: each parameter changes its own key and no other."""
    scene = complete(name if name in DAMPING else "damping.ratio")
    before = scene_parameters(scene)
    changed = before | {name: 1.01 * before[name] + 1e-3 * (before[name] == 0.0)}
    after = scene_parameters(scene_with_parameters(scene, {name: changed[name]}))
    assert after == (before if name.startswith("start.") else changed)


def test_parameters_of_no_robot_are_left_out() -> None:
    """An FMU has more of them, integrators for example."""
    scene = complete("damping.ratio")
    assert scene_with_parameters(scene, {"integrator.fixed_step": 1e-4, "start.x": 0.1}) == scene
