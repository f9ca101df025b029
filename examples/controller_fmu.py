"""A controller as an FMU: exported in C, put into the loop as any foreign FMU would be, the same numbers as its Python twin.

python controller_fmu.py
"""

from pathlib import Path

import numpy as np

from flexfmu import load_scene
from flexfmu.cosim.control.controllers.pid import pd
from flexfmu.cosim.experiment.prepared_scene import run_loop
from flexfmu.fmu_build.block_build import build_block_fmu

scene = load_scene("barnard2012-6kg").replace(
    {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "cosimulation.step": 1e-3, "trajectory.dwell": 0.0}
)
controller = pd(proportional=10e3, derivative=100.0, sample_time=1e-3)
fmu = build_block_fmu(controller, Path("pd.fmu")).path
print(f"{fmu.name}: {fmu.stat().st_size / 1024:.0f} KiB")

python = run_loop(scene, [controller]).recording
exported = run_loop(scene, [fmu]).recording
difference = max(
    np.abs(np.interp(python.time, exported.time, exported[name].values) - python[name].values).max()
    for name in ("joint1.position", "joint2.position")
)
print(f"largest difference of the joint angles: {difference:.1e} rad")
