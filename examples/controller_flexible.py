"""Torques of the rigid robot and of the flexible one as feedforward: what a PD controller is left with.

python controller_flexible.py
"""

import flexfmu

robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})
pd = flexfmu.control.pd(proportional=1e4, derivative=100.0, sample_time=1e-3)

for what, feedforward in {
    "none": [],
    "rigid": [flexfmu.control.feedforward(sample_time=1e-3)],
    "flexible": [flexfmu.control.feedforward(robot="flexible", sample_time=1e-3)],
}.items():
    metrics = flexfmu.run(robot, controllers=[pd, *feedforward]).metrics
    print(f"feedforward: {what:9}   RMS tracking error {1e6 * metrics.rms_tracking_error_1:8.1f} µrad")
