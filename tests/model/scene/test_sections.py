"""What sections of a scene say in several ways, and what follows from them."""

from __future__ import annotations

from typing import Any, get_args

import pytest

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.scene_build import scene_key
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.model.five_bar import assemble
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.motor import Motor
from flexfmu.model.scene.schema import Scene, parse_scene
from flexfmu.model.scene.shapers import ShaperKind
from flexfmu.trajectories.shapers.designs import SHAPERS

SCENE = load_scene("barnard2012-6kg")
PD = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
LAG = {"kind": "lag", "time_constant": 1e-3, "name": "pd"}


def automatic(tolerance: float, own: float | None = None) -> Scene:
    """The paper's scene with effects to be chosen, and perhaps a tolerance of its own for the FMU."""
    data = SCENE.model_dump(exclude_none=True)
    data["effects"] = {"gravity": [0.0, -9.81], "select": "auto", "tolerance": tolerance, "of": ["peak_torque_1"]}
    data["cosimulation"] |= {"tolerance": own}
    if own is None:
        del data["cosimulation"]["tolerance"]
    return parse_scene(data, "test")


@pytest.mark.parametrize(("wished", "own", "left"), [(1e-3, None, 5e-4), (0.5, None, 1e-3), (0.01, 1e-7, 1e-7)])
def test_the_other_half_of_the_tolerance_is_the_integrators(wished: float, own: float | None, left: float) -> None:
    """Half the tolerance goes to the FMU unless the scene gives one, and no looser one than saves time; nothing is simulated before
    the choice, whose model would be a rigid one."""
    scene = automatic(wished, own)
    assert (scene.cosimulation.tolerance, scene.effects.basis) == (left, "craig-bampton")
    assert scene.replace({}) == scene
    with pytest.raises(SceneError, match="leaves the choice of effects open"):
        assemble(scene)


def test_motors_of_both_joints() -> None:
    """One table, values for each joint, and two tables are the same."""
    least = {"continuous_torque": 1.0, "peak_torque": 3.0, "maximum_speed": 300.0}
    one = SCENE.replace({"motor": {**least, "gear_ratio": [5, 10.0], "name": ["A", "B"]}})
    two = [{**least, "gear_ratio": 5, "name": "A"}, {**least, "gear_ratio": 10, "name": "B"}]
    assert one == SCENE.replace({"motor": two})
    assert one.motor is not None
    expected = (Motor(1.0, 3.0, 300.0, gear_ratio=ratio, name=name) for ratio, name in ((5.0, "A"), (10.0, "B")))
    assert tuple(map(one.motor.of_joint, (0, 1))) == tuple(expected)
    assert SCENE.replace({"motor": [least]}) == SCENE.replace({"motor": least})
    changed: Any = one.replace({"motor.gear_ratio[1]": 8.0}).motor
    assert [changed.of_joint(joint).gear_ratio for joint in (0, 1)] == [5.0, 8.0]


def test_names_are_given_once() -> None:
    """Two tables of one name would be told apart by a number that nobody wrote."""
    with pytest.raises(SceneError, match=r"`controller\[0\].name` and `imperfection\[1\].name` are both 'pd'"):
        SCENE.replace({"controller": [PD | {"name": "pd"}], "imperfection": [LAG | {"name": "other"}, LAG]})
    with pytest.raises(InputError, match="the name 'pd' is taken"):
        loop_of(SCENE.replace({"controller": [PD], "imperfection": [LAG]}))


def test_the_loop_needs_no_new_fmu() -> None:
    """Controllers, shapers and imperfections stand outside the FMU; one number stands for the gains of both joints."""
    loop = SCENE.replace({"controller": [PD], "shaper": [{"kind": "zv"}], "imperfection": [LAG | {"name": "lag"}]})
    assert scene_key(loop) == scene_key(SCENE)
    assert hash(loop) != hash(SCENE)
    controller: Any = loop.replace({"controller[0].derivative": [1.0, 2.0]}).controller[0]
    assert (controller.proportional, controller.derivative) == ((1e4, 1e4), (1.0, 2.0))


def test_every_shaper_of_the_catalogue_can_be_named() -> None:
    """Scene files and catalogue know the same shapers."""
    assert set(get_args(ShaperKind)) == set(SHAPERS)
