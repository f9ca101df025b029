"""The sampled shaper in a system: Python slave, exported FMU and closed form are the same shaper."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.shapers import JOINT_REFERENCES, SHAPED, shaper_block
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.simulator import simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.planning import plan
from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.scene.file import load_scene
from flexfmu.trajectories.shapers.designs import design
from flexfmu.trajectories.shapers.sequence import Oscillator, ShapedTrajectory

SAMPLE_TIME = 1e-3


@pytest.mark.parametrize("name", ["zv", "3-hump-ei"])
def test_slave_fmu_and_closed_form_agree(name: str, tmp_path: Path) -> None:
    """Behind a trajectory, at 1 kHz: all three give the same references to 1e-12 of their size."""
    motion = plan(load_scene("barnard2012-6kg")).joints
    sequence = design(name, [Oscillator(58.84, 0.018)])
    block = shaper_block(sequence, SAMPLE_TIME)
    fmu = build_fmu(block, tmp_path / "shaper.fmu").path
    shapers = [BlockSlave(block, "python"), FmuSlave(fmu, "exported")]
    names = list(JOINT_REFERENCES)
    wires = [(f"trajectory.{each}", f"{shaper.name}.{each}") for shaper in shapers for each in names]
    system = connect([TrajectorySlave(motion), *shapers], wires)
    recording = simulate(system, 0.5, SAMPLE_TIME).recording
    time = recording.time
    on_grid = np.abs(time / SAMPLE_TIME - np.round(time / SAMPLE_TIME)) < 1e-6
    samples = on_grid & np.append(np.diff(time) > 0.0, False)  # after the sample was taken; the last one isn't
    expected = ShapedTrajectory(motion, sequence.split(SAMPLE_TIME)).evaluate(time[samples], 2)
    for index, each in enumerate(names):
        closed = expected[index // 2][:, index % 2]
        scale = np.max(np.abs(closed))
        found = [recording[f"{shaper.name}.{SHAPED}{each}"].values[samples] for shaper in shapers]
        np.testing.assert_allclose(found[0] / scale, closed / scale, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(found[1], found[0], rtol=0.0, atol=1e-15 * scale)
