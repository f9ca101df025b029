"""PD control of the joints, alone and with the rigid torques of the motion as feedforward.

python controller_pd.py
"""

import flexfmu

# flexible links alone are next to massless for the motors at high frequency: real ones have an inertia of their own
robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})

feedback = flexfmu.control.pd(proportional=10e3, derivative=100.0, sample_time=1e-3)  # N.m/rad, N.m.s/rad
feedforward = flexfmu.control.feedforward(sample_time=1e-3)

for label, controllers in (("PD", [feedback]), ("PD and feedforward", [feedback, feedforward])):
    found = flexfmu.run(robot, controllers=controllers).metrics
    tracking, torque = found.peak_tracking_error_1, found.peak_torque_1
    print(f"{label:20} tracking error {1e3 * tracking:.3f} mrad, peak torque {torque:.2f} N.m")
