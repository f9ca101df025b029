"""Computed torque at 1 kHz and 4 kHz: rigid inverse dynamics decouple and linearise the joints.

A gain of w² and damping of 2 w make every joint's error a critically damped oscillator of w rad/s, wherever the robot is.

    python controller_computed_torque.py
"""

import flexfmu

robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})
w = 80.0

for sample_time in (1e-3, 0.25e-3):
    controller = flexfmu.control.computed_torque(proportional=w**2, derivative=2 * w, sample_time=sample_time)
    for error in (0.0, 0.3):
        payload = flexfmu.imperfections.payload_error(relative=error)
        found = flexfmu.run(robot, controllers=[controller], imperfections=[payload]).metrics
        print(
            f"{1e-3 / sample_time:.0f} kHz, payload {error:+4.0%}: "
            f"tracking error {1e3 * found.peak_tracking_error_1:6.3f} mrad, "
            f"residual {1e6 * found.residual_vibration_amplitude:7.2f} µm"
        )
