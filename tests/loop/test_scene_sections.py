"""Sections of controllers, shapers and imperfections: what is refused, and what the refusal says."""

from __future__ import annotations

from typing import Any, get_args

import pytest

from flexfmu.fmu_build.scene_build import scene_key
from flexfmu.model.errors import SceneError
from flexfmu.model.scene import Scene
from flexfmu.model.scene_file import load_scene
from flexfmu.model.scene_sections import ShaperKind
from flexfmu.trajectories.shapers.catalogue import SHAPERS

PD = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}

WRONG = {
    "negative gain": (
        "controller",
        PD | {"proportional": -1.0},
        r"`controller\[0\].proportional\[0\]` must be at least 0.0 N.m/rad",
    ),
    "three joints": (
        "controller",
        PD | {"derivative": [1.0, 2.0, 3.0]},
        r"one number for both joints, or a list of two",
    ),
    "word for a gain": ("controller", PD | {"proportional": "high"}, r"`controller\[0\].proportional`.* got 'high'"),
    "no sample time": (
        "controller",
        {"kind": "pd", "proportional": 1.0, "derivative": 1.0},
        r"sample_time` is missing: add it \(in s\)",
    ),
    "unknown kind": ("controller", PD | {"kind": "pdd"}, r"`controller\[0\].kind` must be one of 'pd', 'pid'"),
    "no kind": ("controller", {"proportional": 1.0}, r"`controller\[0\].kind` must be one of 'pd', 'pid'"),
    "misspelt key": ("controller", PD | {"proportionl": 1.0}, r"did you mean `proportional`"),
    "source without a class": ("controller", {"kind": "python", "source": "module"}, r"`controller\[0\].source`"),
    "modes": ("shaper", {"kind": "zv", "modes": "along"}, r'"along-path" or a list'),
    "frequency": (
        "shaper",
        {"kind": "zv", "modes": [{"frequency": -1.0}]},
        r"`shaper\[0\].modes\[0\].frequency` must be above 0.0 Hz",
    ),
    "sampled without a sample time": ("shaper", {"kind": "zv", "apply": "sampled"}, "`sample_time` in s goes with"),
    "analytic with a sample time": ("shaper", {"kind": "zv", "sample_time": 1e-3}, "`sample_time` in s goes with"),
    "less than no payload": ("imperfection", {"kind": "payload-error", "relative": -2.0}, "at least -1"),
    "signal": ("imperfection", {"kind": "delay", "time": 1e-3, "signal": "volume"}, "'torque', 'position'"),
}


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A shipped scene."""
    return load_scene("barnard2012-6kg")


@pytest.mark.parametrize("mistake", WRONG)
def test_mistakes_are_named(scene: Scene, mistake: str) -> None:
    """Key, value, unit and remedy, in one line."""
    section, content, message = WRONG[mistake]
    with pytest.raises(SceneError, match=message) as error:
        scene.replace({section: [content]})
    assert "\n" not in str(error.value)


def test_a_single_table_is_explained(scene: Scene) -> None:
    """[controller] instead of [[controller]] is a common slip."""
    with pytest.raises(SceneError, match=r"write \[\[controller\]\] instead of \[controller\]"):
        scene.replace({"controller": PD})


def test_one_number_stands_for_both_joints(scene: Scene) -> None:
    """And a list for one each."""
    controller: Any = scene.replace({"controller": [PD | {"derivative": [1.0, 2.0]}]}).controller[0]
    assert (controller.proportional, controller.derivative) == ((1e4, 1e4), (1.0, 2.0))


def test_the_loop_needs_no_new_fmu(scene: Scene) -> None:
    """Controllers, shapers and imperfections stand outside the FMU."""
    loop = scene.replace(
        {"controller": [PD], "shaper": [{"kind": "zv"}], "imperfection": [{"kind": "lag", "time_constant": 1e-3}]}
    )
    assert scene_key(loop) == scene_key(scene)
    assert hash(loop) != hash(scene)


def test_every_shaper_of_the_catalogue_can_be_named() -> None:
    """Scene files and catalogue know the same shapers."""
    assert set(get_args(ShaperKind)) == set(SHAPERS)
