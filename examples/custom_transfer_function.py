"""A controller from python-control: lead elements as transfer functions, with foreign names that are connected explicitly.

python custom_transfer_function.py
"""

import control

import flexfmu

robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})

# K_p + K_d s / (1 + T s) for the error of each joint, discretised by Tustin's rule
lead = control.tf([100.0 + 10e3 * 1e-3, 10e3], [1e-3, 1.0])
both = control.append(control.ss(lead), control.ss(lead))

# the error is made of reference and measurement in one matrix: e = [I -I] [q_r; q]
error = control.ss([], [], [], [[1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])
block = flexfmu.control.control_block(
    control.c2d(both * error, 0.5e-3, "tustin"),
    inputs=["target1", "target2", "angle1", "angle2"],
    outputs=["motor1", "motor2"],
    name="lead",
)
connect = {f"lead.target{joint}": f"joint{joint}.reference.position" for joint in (1, 2)}
connect |= {f"lead.angle{joint}": f"joint{joint}.position" for joint in (1, 2)}
connect |= {f"plant.joint{joint}.torque": f"lead.motor{joint}" for joint in (1, 2)}

run = flexfmu.run(robot, controllers=[block], connect=connect)
found = run.metrics
print(f"{run.slaves[2].description}: tracking error {1e3 * found.peak_tracking_error_1:.3f} mrad")
