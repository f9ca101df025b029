"""What an importer may choose of an exported imperfection; that it is the block's equations: tests/cosim/exchange/fmu_export."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from blocks import delay, jitter, noise
from fmpy.fmi2 import FMU2Slave

from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.symbolic import SymbolicBlock

H = 1e-3

RANDOM = {
    "Gauss": noise([0.1, 0.2], seed=5, sample_time=H),
    "uniform": noise(half_width=0.1, seed=5, sample_time=H),
    "jitter": jitter(0.8 * H, 5, sample_time=H, initial=(0.4, -0.6)),
}


@contextmanager
def instance(block: SymbolicBlock, folder: Path, parameters: dict[str, float]) -> Iterator[tuple[FMU2Slave, Any]]:
    """An initialised instance of the block's FMU, and its value references by name."""
    path = build_fmu(block, folder / "block.fmu").path
    description = fmpy.read_model_description(str(path))
    references = {each.name: each.valueReference for each in description.modelVariables}
    slave = FMU2Slave(
        guid=description.guid,
        unzipDirectory=fmpy.extract(str(path), str(folder / "unpacked")),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="block",
    )
    slave.instantiate()
    try:
        slave.setupExperiment(startTime=0.0)
        for name, value in parameters.items():
            slave.setReal([references[name]], [value])
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        yield slave, references
    finally:
        slave.freeInstance()


def exported(block: SymbolicBlock, u: np.ndarray, folder: Path, parameters: dict[str, float]) -> np.ndarray:
    """Outputs (N, outputs) of the block's FMU at its sample instants."""
    rows = []
    with instance(block, folder, parameters) as (slave, references):
        inputs = [references[each.name] for each in block.inputs]
        outputs = [references[each.name] for each in block.outputs]
        for k, values in enumerate(u):
            slave.setReal(inputs, [float(value) for value in values])
            rows.append(slave.getReal(outputs))
            slave.doStep(currentCommunicationPoint=k * H, communicationStepSize=H)
    return np.array(rows)


@pytest.mark.parametrize("block", RANDOM.values(), ids=RANDOM.keys())
def test_seed_of_an_fmu(block: SymbolicBlock, run: Any, tmp_path: Path) -> None:
    """The importer chooses the experiment, and gets the numbers that Python gets for that seed."""
    u, parameters = np.random.default_rng(9).normal(size=(50, 2)), {"seed": 1048575.0}
    got = exported(block, u, tmp_path, parameters)
    np.testing.assert_allclose(got, run(block, u, parameters), rtol=1e-15, atol=1e-15)
    assert not np.isin(got[1:], run(block, u)[1:]).any()


def test_initial_value_of_an_fmu(run: Any, tmp_path: Path) -> None:
    """The importer says where his signal starts."""
    parameters = {"joint1.position.initial": 9.0}
    got = exported(
        delay(5 * H, signal="position", sample_time=H, initial=(0.4, -0.6)), np.zeros((8, 2)), tmp_path, parameters
    )
    np.testing.assert_array_equal(got, [[9.0, -0.6]] * 5 + [[0.0, 0.0]] * 3)
