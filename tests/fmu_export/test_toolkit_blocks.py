"""The toolkit's own controllers and shapers leave as FMUs and give the same numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from export_support.blocks import SAMPLE_TIME, expected
from export_support.instance import run

from flexfmu.cosim.controllers.computed_torque import computed_torque, inverse_dynamics_feedforward
from flexfmu.cosim.controllers.iterative_learning import iterative_learning
from flexfmu.cosim.controllers.limits import symmetric
from flexfmu.cosim.controllers.pd import pd
from flexfmu.cosim.controllers.pid import pid
from flexfmu.cosim.shaping.block import shaper_block
from flexfmu.fmu_build.block_build import build_block_fmu
from flexfmu.fmu_build.validate import validate_fmu
from flexfmu.model.block import SymbolicBlock
from flexfmu.model.rigid_dynamics import inverse_dynamics
from flexfmu.model.scene_file import load_scene
from flexfmu.trajectories.shapers.sequence import ImpulseSequence

SEQUENCE = ImpulseSequence((0.0, 0.0081, 0.0163), (0.3, 0.45, 0.25))


def robot_dynamics() -> Any:
    """Rigid inverse dynamics of the paper's robot."""
    return inverse_dynamics(load_scene("barnard2012-6kg"))


BLOCKS: dict[str, Callable[[], SymbolicBlock]] = {
    "pd": lambda: pd((900.0, 800.0), 12.0, sample_time=SAMPLE_TIME, limits=symmetric(40.0)),
    "pid": lambda: pid(900.0, 4e4, 12.0, sample_time=SAMPLE_TIME, filter_time=3e-3, limits=symmetric(40.0)),
    "computed torque": lambda: computed_torque(robot_dynamics(), 4e3, 90.0, sample_time=SAMPLE_TIME),
    "feedforward": lambda: inverse_dynamics_feedforward(robot_dynamics(), sample_time=SAMPLE_TIME),
    "learning": lambda: iterative_learning(100.0, 3000, sample_time=SAMPLE_TIME, shift=2, forgetting=0.01),
    "shaper": lambda: shaper_block(SEQUENCE, SAMPLE_TIME),
    "fast shaper": lambda: shaper_block(SEQUENCE, SAMPLE_TIME / 200.0),
}


def motion(block: SymbolicBlock, count: int) -> Any:
    """(count, inputs): every input near the start pose of the robot, so that the mechanism can be assembled."""
    random = np.random.default_rng(7)
    elbows = {"joint1": 3.2407, "joint2": 1.1738}
    start = [elbows[each.name[:6]] if each.name.endswith("position") else 0.0 for each in block.inputs]
    return np.array(start) + 0.02 * random.normal(size=(count, len(block.inputs)))


@pytest.mark.parametrize("name", BLOCKS)
def test_exported_block_is_its_functions(name: str, export: Callable[..., Any]) -> None:
    """The same numbers to rounding, over two cycles of what learns and the whole memory of what shapes."""
    block = BLOCKS[name]()
    inputs = motion(block, 6500 if name == "learning" else 4000 if name == "fast shaper" else 300)
    found, exact = run(export(block)(), inputs, block.sample_time), expected(block, inputs)
    np.testing.assert_allclose(found, exact, rtol=0.0, atol=1e-12 * max(1.0, abs(exact).max()))
    assert abs(exact).max() > 0.0


@pytest.mark.parametrize("name", ["pid", "computed torque", "learning", "shaper"])
def test_exported_block_is_valid(name: str) -> None:
    """Descriptions with every unit and limit, and a short life with the start values of all inputs."""
    assert validate_fmu(build_block_fmu(BLOCKS[name](), stop_time=0.1).path) == []
