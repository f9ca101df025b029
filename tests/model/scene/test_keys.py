"""Dotted keys reach every value of a scene, and name what is wrong with them."""

from __future__ import annotations

import re
from typing import Any

import pytest

from flexfmu.model.scene.errors import SceneError
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


@pytest.mark.parametrize(
    ("key", "value", "unit"),
    [
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
    ],
)
def test_every_value_has_a_key(key: str, value: Any, unit: str) -> None:
    """The changed scene has the value, and nothing else changes."""
    changed = SCENE.replace({key: value}).model_dump()
    assert value_at(changed, key) == value
    assert unit_of(location(changed, key), Scene) == unit
    before = SCENE.model_dump()
    set_value(changed, key, value_at(before, key), "scene")
    assert Scene.model_validate(changed) == SCENE


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


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("controller[3].derivative", r"controller has 3 elements, \[0\] to \[2\], named pd, second, feedforward"),
        ("controller.pd.derivative", "controller has 3 elements"),  # two of them are of this kind
        ("pd.derivative", r"pd may be controller\[0\], controller\[1\]; write one of these, or give each a `name`"),
        ("pid.derivative", "`pid` is not a known key"),
        ("second.gain", r"`controller\[1\].gain` is not a known key"),
        ("shaper[0].kind", "shaper has no elements"),
        ("trajectory.start[2]", r"trajectory.start has 2 elements"),
        ("payload.mass.x", "payload.mass is the value 6.0, not a section"),
        ("payload[0]", "payload is the value"),
        ("payload.mas", "did you mean `mass`"),
    ],
)
def test_keys_that_do_not_exist(key: str, message: str) -> None:
    """The message says what there is."""
    with pytest.raises(SceneError, match=message):
        SCENE.replace({key: 1.0})


@pytest.mark.parametrize(
    ("key", "section", "unknown"),
    [
        ("imperfection", [{"kind": "delay", "delay": 2e-3}], "imperfection[0].delay"),
        ("imperfection", [{"kind": "noise", "half_width": 1e-5, "noise": 1.0}], "imperfection[0].noise"),
        ("shaper", [{"kind": "zv", "zv": 3}], "shaper[0].zv"),
        ("trajectory.references", {"kind": "flexible", "flexible": 1}, "trajectory.references.flexible"),
        ("trajectory.blend", {"kind": "lame", "lame": 1, "height": 0.02, "width": 0.02}, "trajectory.blend.lame"),
    ],
)
def test_a_key_that_is_called_like_its_kind(key: str, section: object, unknown: str) -> None:
    """The message blames the key, not the section that it is in."""
    with pytest.raises(SceneError, match=re.escape(f"`{unknown}` is not a known key")):
        load_scene("barnard2012-6kg", {key: section})


def test_keys_of_another_kind_have_one_remedy() -> None:
    """Another kind of motion leaves six keys behind: one sentence says so, and what to do."""
    with pytest.raises(SceneError) as caught:
        load_scene("barnard2012-6kg", {"trajectory.kind": "table"})
    message = str(caught.value)
    assert "`trajectory.file` is missing" in message
    assert (
        "they belong to kind 'pick-and-place', not to 'table'; remove them, or set `trajectory` as a whole" in message
    )
    assert len(message) < 400
    with pytest.raises(SceneError, match=r"`effects\.damping\.ratio` is not a known key: it belongs to kind 'modal'"):
        load_scene("barnard2012-6kg", {"effects.damping": {"kind": "stiffness", "time": 1e-4, "ratio": 0.1}})
    with pytest.raises(
        SceneError, match=r"`payload.one` and `payload.two` are not known keys: known keys here: `mass`"
    ):
        load_scene("barnard2012-6kg", {"payload.one": 1, "payload.two": 2})
