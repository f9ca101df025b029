"""Values that no FMU of the robot takes are refused where they are written, under their keys, before anything is built."""

from __future__ import annotations

from typing import Any

import pytest

from flexfmu.cosim.experiment.parameters import scene_values
from flexfmu.model.plants import torque_driven_plant
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene

STICTION = {"kind": "stiction", "coulomb": 1.0, "breakaway": 2.0, "stribeck_velocity": 0.1, "viscous": 0.1}
RICH: dict[str, Any] = {
    "cosimulation.drive": "torque",
    "effects.proximal_bending": 1,
    "effects.distal_axial": 0,
    "effects.damping": {"kind": "rayleigh", "rate": 1.0, "time": 1e-5},
    "effects.beam": "timoshenko",
    "effects.motor_inertia": 0.1,
    "effects.joint_friction": STICTION,
    "effects.transmission": {"stiffness": 1e4, "damping": 1.0},
    "payload.inertia": 0.01,
}
SMOOTH = {"effects.joint_friction": {"viscous": 0.1, "coulomb": 1.0, "velocity": 0.1}}
MODAL = {"effects.damping": {"kind": "modal", "ratio": 0.1}}


@pytest.mark.parametrize("changes", [RICH, RICH | SMOOTH | MODAL], ids=["rayleigh, stiction", "modal, smooth"])
def test_limits_are_those_of_the_model(changes: dict[str, Any]) -> None:
    """Whatever parameter a model has: just within its limits the scene may be valid, just beyond them it isn't, and its key is named."""
    scene = load_scene("barnard2012-6kg").replace(changes)
    keys = scene_values(scene)
    names = [each for each in torque_driven_plant(scene).parameters if not each.name.startswith("start.")]
    assert len(names) > 15
    for parameter in names:
        key, component = keys[parameter.name].key, parameter.name[-2:]
        assert parameter.minimum is not None
        assert parameter.maximum is not None
        least = 0.99 * parameter.minimum if parameter.minimum > 0.0 else 1.01 * parameter.minimum - 1e-12
        for value in (least, 1.01 * parameter.maximum):
            written = value if component not in (".x", ".y") else [value, 0.0] if component == ".x" else [0.0, value]
            with pytest.raises(SceneError) as refused:
                scene.replace({key: written})
            # a length may be out of reach first, or a tube without a wall
            assert any(part in str(refused.value) for part in (key, key.rpartition(".")[0], "reach")), refused.value
