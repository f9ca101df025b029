"""States of instances that the importer integrates: saved, as bytes, in another process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

TORQUE = {"cosimulation.drive": "torque"}
READER = """
import sys
import fmpy
from fmpy.fmi2 import FMU2Model
path, folder, state = sys.argv[1:]
description = fmpy.read_model_description(path)
fmu = FMU2Model(guid=description.guid, modelIdentifier=description.modelExchange.modelIdentifier,
                unzipDirectory=folder, instanceName="elsewhere")
fmu.instantiate()
fmu.setFMUstate(fmu.deSerializeFMUstate(open(state, "rb").read()))
rates = (fmpy.fmi2.fmi2Real * description.numberOfContinuousStates)()
fmu.getDerivatives(rates, len(rates))
references = [unknown.variable.valueReference for unknown in description.outputs]
seed = fmu.getDirectionalDerivative(references, [0], [1.0])
print(repr(([*rates], fmu.getReal(references), seed)))
"""


def test_bytes_continue_in_another_process(instantiate: Any, plant_path: Any, tmp_path: Path) -> None:
    """Time, states, inputs and parameters: everything that the equations depend on is in a few kilobytes."""
    plant, random = instantiate(TORQUE), np.random.default_rng(7)
    plant.initialize()
    plant.begin()
    plant.fmu.setTime(0.25)
    plant.x = plant.x + 0.1 * plant.nominals * random.normal(size=len(plant.states))
    plant.set(plant.inputs, plant.get(plant.inputs) + random.normal(size=len(plant.inputs)))
    data = plant.fmu.serializeFMUstate(plant.fmu.getFMUstate())
    seed = plant.fmu.getDirectionalDerivative(plant.of(plant.outputs), [0], [1.0])
    expected = [*plant.rates], [*plant.get(plant.outputs)], [*seed]
    assert len(data) < 64 * len(plant.states) * len(plant.outputs)

    (tmp_path / "state").write_bytes(data)
    path, folder = plant_path(TORQUE)
    command = [sys.executable, "-c", READER, str(path), str(folder), str(tmp_path / "state")]
    answer = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert answer.strip() == repr(tuple([float(value) for value in part] for part in expected))
