"""The cost of stiction compared with smooth friction: evaluations of the equations of a torque-driven robot in 3 s.

    python benchmarks/friction_cost.py

PD control at 1 kHz follows sines of 0.1 rad at 1 and 0.7 Hz, tolerance 1e-6.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave

from flexfmu import load_scene
from flexfmu.cosim.experiment.scene_build import build_scene

INTERVAL, COUNT = 1e-3, 3000
STIFFNESS, DAMPING = 500.0, 20.0
EVALUATIONS = 3
"""Value reference of ``statistics.evaluations``."""

ROBOTS = {
    "rigid links": {"effects.proximal_bending": 0, "effects.distal_axial": 0, "effects.motor_inertia": 0.1},
    "12 elastic coordinates": {"effects.motor_inertia": 0.1},
    "the same, elastic transmissions": {
        "effects.motor_inertia": 0.1,
        "effects.transmission": {"stiffness": 2e4, "damping": 5.0},
    },
}
FRICTIONS = {
    "smooth, 0.01 rad/s": {"coulomb": 2.0, "velocity": 1e-2},
    "smooth, 1e-4 rad/s": {"coulomb": 2.0, "velocity": 1e-4},
    "sticking": {"kind": "stiction", "coulomb": 2.0},
    "sticking, breakaway 3 N m": {"kind": "stiction", "coulomb": 2.0, "breakaway": 3.0},
    "sticking, breakaway 3 N m, Stribeck 0.05 rad/s": {
        "kind": "stiction",
        "coulomb": 2.0,
        "breakaway": 3.0,
        "stribeck_velocity": 0.05,
    },
}


def simulate(fmu: Path, folder: Path) -> tuple[int, float]:
    """Evaluations, and the share of samples at which a motor stands still."""
    description = fmpy.read_model_description(str(fmu))
    reference = {variable.name: variable.valueReference for variable in description.modelVariables}
    torques, positions, rates = (
        [reference[f"joint{joint}.{kind}"] for joint in (1, 2)] for kind in ("torque", "position", "velocity")
    )
    slave = FMU2Slave(
        guid=description.guid,
        unzipDirectory=fmpy.extract(str(fmu), str(folder)),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="plant",
    )
    slave.instantiate()
    slave.setupExperiment(tolerance=1e-6, startTime=0.0)
    slave.enterInitializationMode()
    holding, start = np.array(slave.getReal(torques)), np.array(slave.getReal(positions))
    slave.exitInitializationMode()
    standing = 0
    for k in range(COUNT):
        goal = start + 0.1 * np.sin(2 * np.pi * np.array([1.0, 0.7]) * k * INTERVAL)
        position, rate = np.array(slave.getReal(positions)), np.array(slave.getReal(rates))
        slave.setReal(torques, list(holding + STIFFNESS * (goal - position) - DAMPING * rate))
        slave.doStep(k * INTERVAL, INTERVAL)
        standing += int(np.sum(rate == 0.0))
    evaluations = int(slave.getInteger([EVALUATIONS])[0])
    slave.terminate()
    slave.freeInstance()
    return evaluations, standing / (2 * COUNT)


def main() -> None:
    print("| Robot | Friction | Evaluations | of smooth, 0.01 rad/s | Standing still |\n|---|---|---:|---:|---:|")
    for robot, changes in ROBOTS.items():
        first = 0
        for name, friction in FRICTIONS.items():
            scene = load_scene("barnard2012-6kg").replace(
                {"cosimulation.drive": "torque", **changes, "effects.joint_friction": {"viscous": 0.5, **friction}}
            )
            with tempfile.TemporaryDirectory() as folder:
                fmu = build_scene(scene, output=Path(folder) / "plant.fmu").path
                evaluations, share = simulate(fmu, Path(folder) / "unpacked")
            first = first or evaluations
            print(f"| {robot} | {name} | {evaluations} | {evaluations / first:.2f} | {share:.1%} |")


if __name__ == "__main__":
    main()
