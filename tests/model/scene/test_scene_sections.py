"""Sections of controllers, shapers and imperfections: what is refused, and what the refusal says."""

from __future__ import annotations

import math
from typing import Any, get_args

import pytest

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.scene_build import scene_key
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.scene.shapers import ShaperKind
from flexfmu.trajectories.shapers.designs import SHAPERS

PD = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
FMU = {"kind": "fmu", "path": "mine.fmu"}

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
    "band the wrong way round": ("shaper", {"kind": "si", "band": [60.0, 40.0]}, r"got \[60.0, 40.0\]"),
    "less than no payload": ("imperfection", {"kind": "payload-error", "relative": -2.0}, "at least -1"),
    "two kinds of limits": (
        "imperfection",
        {"kind": "saturation", "limit": 1.0, "lower": -1.0, "upper": 1.0},
        "either `limit`, which holds both ways, or `lower` and `upper`",
    ),
    "one limit of two": ("imperfection", {"kind": "saturation", "lower": -1.0}, "or `lower` and `upper`"),
    "limits the wrong way round": (
        "imperfection",
        {"kind": "saturation", "lower": 1.0, "upper": -1.0},
        r"`lower` must be below `upper`, got \[1.0, 1.0\]",
    ),
    "noise of no strength": ("imperfection", {"kind": "noise"}, "either `standard_deviation`, for normal noise"),
    "interpolation": (
        "imperfection",
        {"kind": "delay", "time": 1e-3, "interpolation": "cubic"},
        r"`imperfection\[0\].interpolation.kind` must be one of 'linear', 'lagrange', 'thiran', got 'cubic'",
    ),
    "anti-windup without a kind": (
        "controller",
        PD | {"kind": "pid", "integral": 1.0, "anti_windup": {"tracking_time": 0.1}},
        r"`controller\[0\].anti_windup.kind` must be one of 'clamping', 'back-calculation', 'none', but is missing",
    ),
    "anti-windup": (
        "controller",
        PD | {"kind": "pid", "integral": 1.0, "anti_windup": "back-calculation"},
        r"tracking_time` is missing: add it \(in s\)",
    ),
    "no cycles": (
        "controller",
        {"kind": "learning", "gain": 1.0, "cycles": 0, "sample_time": 1e-3},
        r"`controller\[0\].cycles` must be at least 1 cycles",
    ),
    "list for a parameter": (
        "controller",
        FMU | {"parameters": {"gain": [1.0, 2.0]}},
        r"^in `controller\[0\]\.parameters\.gain`: give one finite number, .* got \[1\.0, 2\.0\] \(scene [^;()]*\)$",
    ),
    "no number for a parameter": (
        "controller",
        FMU | {"parameters": {"gain": math.nan}},
        r"^in [^;]*got nan \(scene [^;()]*\)$",
    ),
    "the robot's name": (
        "controller",
        PD | {"name": "plant"},
        r"^in `controller\[0\].name`: 'plant' is the robot's own name, choose another",
    ),
    "the motion's name": ("shaper", {"kind": "zv", "name": "trajectory"}, r"'trajectory' is the planned motion's own"),
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


COUPLING = {
    "algorithm": ({"algorithm": "seidel"}, "'gauss-seidel', 'jacobi' or 'implicit', got 'seidel'"),
    "tolerance": ({"step_control": {"tolerance": 0.0}}, "`cosimulation.step_control.tolerance` must be above 0.0"),
    "steps": (
        {"step_control": {"tolerance": 1e-3, "minimum": 1.0, "maximum": 0.1}},
        "`minimum` must be at most `maximum` = 0.1 s, got 1.0 s",
    ),
    "solver": ({"loop_solver": {"kind": "newton"}}, "must be one of 'fixed-point', 'anderson', got 'newton'"),
}


@pytest.mark.parametrize("mistake", COUPLING)
def test_mistakes_in_the_coupling_are_named(scene: Scene, mistake: str) -> None:
    """Key, value and what there is."""
    changes, message = COUPLING[mistake]
    with pytest.raises(SceneError, match=message):
        scene.replace({f"cosimulation.{key}": value for key, value in changes.items()})


def test_names_are_given_once(scene: Scene) -> None:
    """Two tables of one name would be told apart by a number that nobody wrote."""
    lag = {"kind": "lag", "time_constant": 1e-3, "name": "pd"}
    with pytest.raises(SceneError, match=r"`controller\[0\].name` and `imperfection\[1\].name` are both 'pd'"):
        scene.replace({"controller": [PD | {"name": "pd"}], "imperfection": [lag | {"name": "other"}, lag]})
    with pytest.raises(InputError, match="the name 'pd' is taken"):
        loop_of(scene.replace({"controller": [PD], "imperfection": [lag]}))


def test_a_single_table_is_explained(scene: Scene) -> None:
    """[controller] instead of [[controller]] is a common slip."""
    with pytest.raises(SceneError, match=r"write \[\[controller\]\] instead of \[controller\]"):
        scene.replace({"controller": PD})
    with pytest.raises(
        SceneError, match=r"`shaper` is a list of tables: write \[\[shaper\]\] and the keys .* got 'zv'"
    ):
        scene.replace({"shaper": "zv"})


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
