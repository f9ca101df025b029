"""The robot carries something else than its controller believes.

python imperfection_payload.py
"""

import flexfmu

robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})
controller = flexfmu.control.computed_torque(proportional=6400.0, derivative=160.0, sample_time=1e-3)

METRICS = ("peak_torque_1", "peak_tracking_error_1", "residual_vibration_amplitude", "settling_time")
for relative in (-0.3, -0.1, 0.0, 0.1, 0.3):
    payload = flexfmu.imperfections.payload_error(relative=relative)
    run = flexfmu.run(robot, controllers=[controller], imperfections=[payload])
    found = run.metrics
    print(f"{run.robot.payload.mass:.1f} kg", *(f"{flexfmu.display(name, found[name], 4):>14}" for name in METRICS))
