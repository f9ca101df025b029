"""A controller in C: the function of controller_c_function.c, in the loop and as an FMU.

python controller_c_function.py
"""

from pathlib import Path

import flexfmu

robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})

# names in the order of u, y, p and x of the function
kinds = ("reference.position", "reference.velocity", "position", "velocity")
controller = flexfmu.control.c_function(
    source=str(Path(__file__).with_suffix(".c")),
    inputs=[f"joint{joint}.{kind}" for kind in kinds for joint in (1, 2)],
    outputs=["joint1.torque", "joint2.torque"],
    parameters={"proportional": 1e4, "derivative": 100.0, "pole": 0.2},
    states=[0.0, 0.0],
    units={"proportional": "N.m/rad", "derivative": "N.m.s/rad"},
    sample_time=0.5e-3,
)
first = flexfmu.run(robot, controllers=[controller])
(exported,) = flexfmu.export_slaves(first.scene, Path("fmus"), names=["c_function"]).slaves
second = flexfmu.run(robot, controllers=[exported.path])
for label, run in (("C", first), ("its FMU", second)):
    print(f"{label:8} tracking error {1e3 * run.metrics.peak_tracking_error_1:.6f} mrad")
