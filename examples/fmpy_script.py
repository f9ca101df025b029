"""Build the FMU and run it without flexfmu: fmpy alone, as any other tool that imports FMI 2.0 would.

First the robot stands still: by default the references hold the start pose, so only the static torques are left. Then it follows
a motion sampled at 1 kHz, linear in between: all that a tool can send that knows no input derivatives.

    python fmpy_script.py
"""

import numpy as np
from fmpy import simulate_fmu

import flexfmu

scene = flexfmu.load_scene("barnard2012-6kg")
fmu = flexfmu.build(scene)
OUTPUTS = ["joint1.torque", "joint2.torque", "end_effector.position.y"]

still = simulate_fmu(str(fmu), output=OUTPUTS, stop_time=0.1, output_interval=1e-3)
print(f"standing still: {still['joint1.torque'][0]:.4f} N.m, after 0.1 s {still['joint1.torque'][-1]:.4f} N.m")

# the planned joint motion as the table of inputs that fmpy wants
time = np.arange(0.0, scene.trajectory.duration + scene.trajectory.dwell, 1e-3)
motion = flexfmu.reference_motion(scene).joints.evaluate(time, order=2)  # (derivative, instant, joint)
KINDS = ("position", "velocity", "acceleration")
names = [f"joint{joint}.reference.{kind}" for joint in (1, 2) for kind in KINDS]
table = np.zeros(time.size, dtype=[("time", float), *((name, float) for name in names)])
table["time"] = time
for joint in (0, 1):
    for derivative, kind in enumerate(KINDS):
        table[f"joint{joint + 1}.reference.{kind}"] = motion[derivative, :, joint]

# parameters are start values: another payload needs no other FMU
for mass in (6.0, 0.1):
    result = simulate_fmu(
        str(fmu),
        start_values={"payload.mass": mass},
        input=table,
        output=OUTPUTS,
        output_interval=1e-3,
        stop_time=time[-1],
    )
    print(f"moving {mass:g} kg: peak torque {np.abs(result['joint1.torque']).max():.2f} N.m")
