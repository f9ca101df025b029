"""Other people's tools run our FMUs as ours does.

Motion and robot step side by side (Jacobi) with inputs held over the step, which is of order 1. Given the same rule, our master
has the same numbers; and as the step becomes smaller, all tend to what ours finds with derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from export_support.blocks import SAMPLE_TIME, expected
from export_support.kinds import KINDS, motion, seen_late, signals_of, source
from third_party_support.agreement import ROUNDING, TOOLS, SharedRun, Tool, apart, exact, shared_run, tool

from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicBlock

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
    """Three FMUs in a loop, with everything connected that a controller wants. Other masters read
    outputs before they set inputs: torques come a communication step late, which vanishes with the step."""
    signals = ("end_effector.position.x", "joint1.position", "joint1.velocity")
    shared = shared_run(load_scene("barnard2012-6kg").replace(CONTROLLED), tmp_path, signals)
    expected = tool("libcosim").simulate(shared, STEPS[0])
    assert apart(tool("Maestro").simulate(shared, STEPS[0]), expected) < ROUNDING
    assert apart(tool("ecos").simulate(shared, STEPS[0]), expected) < ROUNDING
    late = [apart(tool("ecos").simulate(shared, step), exact(shared, step)) for step in (STEPS[1], STEPS[1] / 2)]
    assert late[1] < 0.01
    assert late[0] / late[1] > 1.8


SAMPLES = 160
"""Of the blocks: ramps, sines and steps at every input, and more than the longest memory."""


def side_by_side(blocks: Mapping[str, SymbolicBlock], folder: Path) -> SharedRun:
    """The blocks' FMUs, all fed by one source."""
    fmus, connections, signals = {"source": str(build_fmu(source()).path)}, [], []
    for number, block in enumerate(blocks.values()):
        name = f"block{number}"
        fmus[name] = str(build_fmu(block).path)
        pairs = zip(signals_of(block), block.inputs, strict=True)
        connections += [[f"source.signal{i}", f"{name}.{each.name}"] for i, each in pairs]
        signals += [f"{name}.{each.name}" for each in block.outputs]
    system = {"fmus": fmus, "connections": connections, "signals": signals}
    return SharedRun(load_scene("barnard2012-6kg"), system, folder)


@pytest.mark.parametrize("name", ["libcosim", "ecos", "Maestro"])
def test_every_kind_of_block(name: str, tmp_path: Path) -> None:
    """Ramps, sines and steps at all inputs: a tool that records before it sets inputs has the sample before where outputs
    depend on inputs at once, one that records afterwards this one; neither has new states with old inputs. Maestro, whose
    preparation takes long, gets blocks with memory of each kind of sampling: of states, of sums, of past samples, drawn."""
    blocks = {kind: make() for kind, make in KINDS.items()}
    if name == "Maestro":
        blocks = {kind: blocks[kind] for kind in ("pid", "state-feedback", "shaper", "delay", "noise")}
    shared = side_by_side(blocks, tmp_path)
    found = tool(name).simulate(shared, SAMPLE_TIME, stop=SAMPLES * SAMPLE_TIME)[:SAMPLES]
    assert len(found) >= SAMPLES - 1
    rule = seen_late if tool(name).records == "before" else expected
    exact = {kind: rule(block, motion(block, SAMPLES + 1))[1 : len(found) + 1] for kind, block in blocks.items()}
    assert found.shape[1] == sum(each.shape[1] for each in exact.values())
    parts = np.split(found, np.cumsum([each.shape[1] for each in exact.values()])[:-1], axis=1)
    for (kind, values), part in zip(exact.items(), parts, strict=True):
        np.testing.assert_allclose(part, values, rtol=0.0, atol=1e-12 * max(1.0, abs(values).max()), err_msg=kind)
