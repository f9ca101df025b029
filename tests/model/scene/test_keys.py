"""Dotted keys reach every value of a scene, and name what is wrong with them."""

from __future__ import annotations

from typing import Any

import pytest

from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.keys import location, set_value, value_at
from flexfmu.model.scene.messages import unit_of
from flexfmu.model.scene.schema import Scene

PD = {"kind": "pd", "proportional": 5e3, "derivative": 20.0, "sample_time": 1e-3}
SCENE = load_scene("barnard2012-6kg").replace(
    {
        "cosimulation.drive": "torque",
        "controller": [PD, {**PD, "name": "second"}, {"kind": "feedforward", "sample_time": 1e-3}],
    }
)


@pytest.mark.parametrize(("key", "value", "unit"), [
    ("payload.mass", 2.5, "kg"),
    ("trajectory.duration", 0.3, "s"),
    ("trajectory.blend.height", 0.02, "m"),
    ("trajectory.start[0]", -0.17, "m"),
    ("effects.gravity[1]", 0.0, "m/s2"),
    ("cosimulation.step", 1e-3, "s"),
    ("controller[0].derivative[1]", 30.0, "N.m.s/rad"),
    ("controller[1].sample_time", 5e-4, "s"),
    ("controller.second.sample_time", 5e-4, "s"),
    ("controller.feedforward.payload", 4.0, "kg"),
    ("controller.1.sample_time", 5e-4, "s"),
    ("controller.0.kd[1]", 30.0, "N.m.s/rad"),
    ("second.sample_time", 5e-4, "s"),
    ("second.kp[0]", 4e3, "N.m/rad"),
    ("feedforward.payload", 4.0, "kg"),
    ("trajectory.profile.kind", "bang-bang", ""),
])  # fmt: skip
def test_every_value_has_a_key(key: str, value: Any, unit: str) -> None:
    """The changed scene has the value, and nothing else changes."""
    changed = SCENE.replace({key: value}).model_dump()
    assert value_at(changed, key) == value
    assert unit_of(location(changed, key), Scene) == unit
    before = SCENE.model_dump()
    set_value(changed, key, value_at(before, key), "scene")
    assert Scene.model_validate(changed) == SCENE


def test_given_tables_stay_as_they_are() -> None:
    """A dotted key may change a table that is given with it, but not the caller's."""
    changes: dict[str, Any] = {"payload": {"mass": 2.0}, "payload.mass": 1.0}
    assert SCENE.replace(changes).payload.mass == 1.0
    assert changes["payload"] == {"mass": 2.0}


def test_short_names_of_gains_within_a_slave() -> None:
    """Also in the tables of a cascade's loops; arguments of slaves of one's own have their own names."""
    cascade = {
        "kind": "cascade",
        "position": {"proportional": 30.0},
        "velocity": {"proportional": 9.0},
        "sample_time": 1e-3,
    }
    own = {"kind": "python", "source": "module:name", "arguments": {"kp": 1.0}}
    scene = SCENE.replace({"controller": [cascade, own]}).replace(
        {"cascade.velocity.kp[1]": 8.0, "python.arguments.kp": 2.0}
    )
    first, second = (each.model_dump() for each in scene.controller)
    assert first["velocity"]["proportional"] == (9.0, 8.0)
    assert second["arguments"] == {"kp": 2.0}
