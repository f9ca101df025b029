"""Everything of a scene as FMUs: trajectory, robot and controller, with the connections between them.

python export_slaves.py
"""

from pathlib import Path

import flexfmu

pd = flexfmu.control.pd(proportional=10e3, derivative=100.0, sample_time=1e-3)
scene = flexfmu.load_scene("barnard2012-6kg").replace(
    {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "controller": [pd]}
)
system = flexfmu.export_slaves(scene, Path("fmus"))
for slave in system.slaves:
    print(f"{slave.path}: {slave.facts.description}")
for source, target in system.connections:
    print(f"{source} -> {target}")
