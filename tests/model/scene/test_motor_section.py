"""The section `motor`: one table for both joints, values for each, or two tables; what is wrong is said in one line."""

from __future__ import annotations

from typing import Any

import pytest

from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.motor import Motor
from flexfmu.model.scene.schema import Scene

LEAST = {"continuous_torque": 1.0, "peak_torque": 3.0, "maximum_speed": 300.0}


def scene(motor: Any) -> Scene:
    """The shipped scene with motors."""
    return load_scene("barnard2012-6kg").replace({"motor": motor})


def motors(found: Scene) -> tuple[Motor, Motor]:
    """The motors of both joints."""
    assert found.motor is not None
    return found.motor.of_joint(0), found.motor.of_joint(1)


def test_ways_to_write_it() -> None:
    """One table, values for each joint, and two tables are the same."""
    assert load_scene("barnard2012-6kg").motor is None
    one = scene({**LEAST, "gear_ratio": [5, 10.0], "name": ["A", "B"]})
    assert one == scene([{**LEAST, "gear_ratio": 5, "name": "A"}, {**LEAST, "gear_ratio": 10, "name": "B"}])
    assert motors(one) == (
        Motor(1.0, 3.0, 300.0, gear_ratio=5.0, name="A"),
        Motor(1.0, 3.0, 300.0, gear_ratio=10.0, name="B"),
    )
    assert scene([LEAST]) == scene(LEAST)
    assert motors(one.replace({"motor.gear_ratio": 7.0}))[1].gear_ratio == 7.0
    assert motors(one.replace({"motor.gear_ratio[1]": 8.0}))[0].gear_ratio == 5.0


@pytest.mark.parametrize(
    ("motor", "message"),
    [
        ({**LEAST, "peak_torque": 0.5}, "`peak_torque` must be at least `continuous_torque` = 1.0 N.m, got 0.5 N.m"),
        ({**LEAST, "maximum_speed": -1.0}, "`motor.maximum_speed[0]` must be above 0.0 rad/s, got -1.0 rad/s"),
        ({**LEAST, "gear_efficiency": [0.9, 1.2]}, "`motor.gear_efficiency[1]` must be at most 1.0, got 1.2"),
        ({**LEAST, "gear_ratio": "5"}, "give one number for both joints, or a list of two, got '5'"),
        ({**LEAST, "gear_ratio": float("nan")}, "`motor.gear_ratio[0]`"),
        ({**LEAST, "winding_resistance": 1.0}, "`winding_resistance` needs `torque_constant` [N.m/A]"),
        ({**LEAST, "torque_constant": 0.0}, "`motor.torque_constant[0]` must be above 0.0 N.m/A, got 0.0 N.m/A"),
        ({**LEAST, "gearratio": 5.0}, "`motor.gearratio` is not a known key: did you mean `gear_ratio`?"),
        ({"peak_torque": 3.0, "maximum_speed": 1.0}, "`motor.continuous_torque` is missing: add it (in N.m)"),
        (
            [LEAST, {**LEAST, "gear_ratio": 2.0}],
            "`motor[0]` has no `gear_ratio`, but the other motor has: give it for both",
        ),
        ([LEAST] * 3, "`motor` is one table for both joints, or a list of two, got a list of 3"),
        ([], "`motor` is one table for both joints, or a list of two, got a list of 0"),
        (3.0, "`motor` must be a table like { key = value }"),
        ({**LEAST, "name": 3}, "`motor.name`"),
    ],
)
def test_what_is_wrong(motor: Any, message: str) -> None:
    """Each mistake is named with its key, value and unit."""
    with pytest.raises(SceneError) as error:
        scene(motor)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
