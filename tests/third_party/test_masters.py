"""Other people's tools run our FMUs as ours does.

Motion and robot step side by side (Jacobi) with inputs held over the step. Given the same rule, our master has the same numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from export_support.blocks import SAMPLE_TIME, expected
from export_support.kinds import KINDS, motion, seen_late, signals_of, source
from third_party_support.agreement import TOOLS, SharedRun, Tool, apart, shared_run, tool

from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicBlock

pytestmark = pytest.mark.slow

STEP = 1e-3
"""Communication step [s]."""

FOLLOWERS = [each for each in TOOLS if each.like]


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> SharedRun:
    """The paper's motion and robot."""
    return shared_run(load_scene("barnard2012-6kg"), tmp_path_factory.mktemp("motion"))


@pytest.mark.parametrize("follower", FOLLOWERS, ids=lambda each: each.name)
def test_the_same_rule_gives_the_same_numbers(follower: Tool, shared: SharedRun) -> None:
    """Tools of different people, in different languages, agree at every communication point."""
    found, expected = (each.simulate(shared, STEP) for each in (follower, tool(follower.like)))
    assert len(found) >= len(expected) - 1
    assert apart(found, expected) < follower.within


def test_both_versions_have_the_same_bits(shared: SharedRun, tmp_path: Path) -> None:
    """ecos imports FMI 3.0 too."""
    newer = shared_run(shared.scene, tmp_path, fmi="3")
    np.testing.assert_array_equal(*(tool("ecos").simulate(each, STEP) for each in (shared, newer)))


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
