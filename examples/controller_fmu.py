"""A controller as an FMU: exported in C, put into the loop as any foreign FMU would be, the same numbers as its Python twin.

python controller_fmu.py
"""

from pathlib import Path

import numpy as np

import flexfmu

robot = flexfmu.load_scene("barnard2012-6kg").replace(
    {"effects.motor_inertia": 0.1, "cosimulation.step": 1e-3, "trajectory.dwell": 0.0}
)
pd = flexfmu.control.pd(proportional=10e3, derivative=100.0, sample_time=1e-3)
run = flexfmu.run(robot, controllers=[pd])

(slave,) = flexfmu.export_slaves(run.scene, Path("fmus"), names=["pd"]).slaves
print(f"{slave.path.name}: {slave.path.stat().st_size / 1024:.0f} KiB")

python, exported = run.recording, flexfmu.run(robot, controllers=[slave.path]).recording
difference = max(
    np.abs(np.interp(python.time, exported.time, exported[name].values) - python[name].values).max()
    for name in ("joint1.position", "joint2.position")
)
print(f"largest difference of the joint angles: {difference:.1e} rad")
