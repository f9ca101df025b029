"""Other people's tools run our FMUs as ours does.

Motion and robot step side by side (Jacobi) with inputs held over the step, which is of order 1. Given the same rule, our master
has the same numbers; and as the step becomes smaller, all tend to what ours finds with derivatives.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from third_party_support.agreement import ROUNDING, TOOLS, SharedRun, Tool, apart, exact, shared_run, tool

from flexfmu.model.scene_file import load_scene

pytestmark = pytest.mark.slow

STEPS = (1e-3, 5e-4)
"""Communication steps [s]."""

FOLLOWERS = [each for each in TOOLS if each.like]
QUICK = [each for each in TOOLS if each.name != "Maestro"]

CONTROLLED = {
    "name": "controlled",
    "cosimulation.drive": "torque",
    "cosimulation.step": 1e-3,
    "effects.motor_inertia": 0.1,
    "controller": [{"kind": "pd", "proportional": 1000.0, "derivative": 30.0, "sample_time": 1e-3}],
}
"""The robot's positions and velocities go to a controller: states and their derivatives are connected."""


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> SharedRun:
    """The paper's motion and robot."""
    return shared_run(load_scene("barnard2012-6kg"), tmp_path_factory.mktemp("motion"))


@pytest.mark.parametrize("follower", FOLLOWERS, ids=lambda each: each.name)
def test_the_same_rule_gives_the_same_numbers(follower: Tool, shared: SharedRun) -> None:
    """Tools of different people, in different languages, agree at every communication point."""
    found, expected = (each.simulate(shared, STEPS[0]) for each in (follower, tool(follower.like)))
    assert len(found) >= len(expected) - 1
    assert apart(found, expected) < follower.within


@pytest.mark.parametrize("each", QUICK, ids=lambda each: each.name)
def test_half_the_step_halves_the_difference(each: Tool, shared: SharedRun) -> None:
    """Held inputs are late by up to a step, so what a tool finds tends to our result with order 1."""
    differences = [apart(each.simulate(shared, step), exact(shared, step)) for step in STEPS]
    assert differences[0] / differences[1] == pytest.approx(2.0, rel=0.1)


def test_controlled_robot_in_other_masters(tmp_path: Path) -> None:
    """Three FMUs in a loop, with everything connected that a controller wants. Other masters know no sample times: a
    controller measures a communication step late, which vanishes with the step."""
    signals = ("end_effector.position.x", "joint1.position", "joint1.velocity")
    shared = shared_run(load_scene("barnard2012-6kg").replace(CONTROLLED), tmp_path, signals)
    expected = tool("libcosim").simulate(shared, STEPS[0])
    assert apart(tool("Maestro").simulate(shared, STEPS[0]), expected) < ROUNDING
    assert apart(tool("ecos").simulate(shared, STEPS[0]), expected) < ROUNDING
    late = [apart(tool("ecos").simulate(shared, step), exact(shared, step)) for step in (STEPS[1], STEPS[1] / 2)]
    assert late[1] < 0.01
    assert late[0] / late[1] > 1.8
