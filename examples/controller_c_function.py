"""A controller in C: the function of controller_c_function.c, in the loop and as an FMU.

python controller_c_function.py
"""

from pathlib import Path

import flexfmu
from flexfmu.cosim.control.controllers.c_function import c_function
from flexfmu.cosim.experiment.prepared_scene import run_loop
from flexfmu.fmu_build.block_build import build_block_fmu

robot = flexfmu.load_scene("barnard2012-6kg").replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1})

# names in the order of u, y, p and x of the function
kinds = ("reference.position", "reference.velocity", "position", "velocity")
block = c_function(
    Path(__file__).with_suffix(".c"),
    inputs=[f"joint{joint}.{kind}" for kind in kinds for joint in (1, 2)],
    outputs=["joint1.torque", "joint2.torque"],
    parameters={"proportional": 1e4, "derivative": 100.0, "pole": 0.2},
    states=[0.0, 0.0],
    units={"proportional": "N.m/rad", "derivative": "N.m.s/rad"},
    sample_time=0.5e-3,
)
fmu = build_block_fmu(block, Path("controller.fmu")).path
for label, controller in (("C", block), ("its FMU", str(fmu))):
    run = run_loop(robot, [controller])
    print(f"{label:8} tracking error {1e3 * run.metrics.peak_tracking_error_1:.6f} mrad")
