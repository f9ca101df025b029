"""Energy of the free robot in the FMU itself: undamped, motors locked, disturbed by an undeformed start under gravity."""

from __future__ import annotations

from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave

from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.numeric import numeric_model, standstill
from flexfmu.model.plants import build_model
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium

STEPS, STEP = 100_000, 1e-4


@pytest.fixture(scope="module")
def undamped() -> Scene:
    return load_scene("barnard2012-6kg").replace(
        {"effects.damping": {"kind": "none"}, "cosimulation.initial": "undeformed"}
    )


def open_slave(path: Path, tolerance: float) -> tuple[FMU2Slave, dict[str, int]]:
    """The FMU, initialised at its start pose."""
    description = fmpy.read_model_description(str(path))
    slave = FMU2Slave(
        guid=description.guid,
        unzipDirectory=fmpy.extract(str(path), str(path.parent / "unpacked")),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="energy",
    )
    slave.instantiate()
    slave.setupExperiment(tolerance=tolerance, startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    return slave, {variable.name: variable.valueReference for variable in description.modelVariables}


def test_total_energy_stays_within_1e_9_over_1e5_steps(undamped: Scene, tmp_path: Path) -> None:
    """Ten seconds of free vibration neither gain nor lose energy, measured against the energy of the vibration alone."""
    path = build_fmu(lambda: build_model(undamped), output=tmp_path / "undamped.fmu").path
    model = numeric_model(undamped)
    joints = motor_angles(undamped.mechanism, undamped.trajectory.start)
    u = standstill(joints)
    names = build_model(undamped).unknowns
    slave, references = open_slave(path, tolerance=1e-10)
    positions = [references[name] for name in names]
    rates = [references[f"der({name})"] for name in names]

    def total_energy() -> float:
        kinetic, potential = model.energy(slave.getReal(positions), slave.getReal(rates), u).full().ravel()
        return float(kinetic + potential)

    start = total_energy()
    rest = float(model.energy(static_equilibrium(undamped, joints).elastic, np.zeros(model.n), u)[1])
    drift = 0.0
    for step in range(STEPS):
        slave.doStep(currentCommunicationPoint=step * STEP, communicationStepSize=STEP)
        if step % 50 == 0:
            drift = max(drift, abs(total_energy() - start))
    slave.terminate()
    slave.freeInstance()
    assert start > rest
    assert drift <= 1e-9 * (start - rest)
