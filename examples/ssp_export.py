"""A whole scene as one SSP 1.0 file, and back: same numbers, other steps, other parameters.

python ssp_export.py
"""

from pathlib import Path

import numpy as np
from fmpy.ssp.ssd import read_ssd

import flexfmu

scene = flexfmu.load_scene("barnard2012-6kg").replace(
    {
        "cosimulation.drive": "torque",
        "effects.motor_inertia": 0.1,
        "trajectory.dwell": 0.0,
        "controller": [flexfmu.control.pd(proportional=1e4, derivative=100.0, sample_time=1e-3)],
        "imperfection": [flexfmu.imperfections.encoder(counts_per_turn=1e6)],
    }
)
path = flexfmu.export_ssp(scene, Path("scene.ssp"))
system = read_ssd(path, validate=True).system
print(f"{path.name}: {path.stat().st_size / 1024:.0f} KiB, valid; {', '.join(each.name for each in system.elements)}")

SIGNAL = "end_effector.position.x"
expected = flexfmu.run(scene).recording[SIGNAL]
loaded = flexfmu.load_ssp(path)
found = loaded.simulate().recording[SIGNAL]
print(f"largest difference to the scene's own run: {np.abs(found.values - expected.values).max():.1e} m")

coarse = flexfmu.load_ssp(path, step=2 * loaded.step).simulate().recording[SIGNAL]
print(f"end, twice the step: {coarse.values[-1]:.9f} m; as exported: {found.values[-1]:.9f} m")
