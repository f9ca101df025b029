"""A payload that is 30 % heavier than the controllers assume: rigid torques as feedforward, and an observer for what they lack.

python controller_disturbance_observer.py
"""

import flexfmu

robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1, "trajectory.dwell": 0.3})
heavier = flexfmu.imperfections.payload_error(relative=0.3)
pd = flexfmu.control.pd(proportional=1e4, derivative=100.0, sample_time=1e-3)
gravity = flexfmu.control.gravity_feedforward(sample_time=1e-3)
torques = flexfmu.control.feedforward(sample_time=1e-3)
observer = flexfmu.control.disturbance_observer(time_constant=0.01, sample_time=1e-3)

for what, controllers in {
    "PD": [pd],
    "with gravity": [pd, gravity],
    "with all torques": [pd, torques],
    "with an observer, too": [pd, torques, observer],
}.items():
    recording = flexfmu.run(robot, controllers=controllers, imperfections=[heavier]).recording
    error = 1e3 * (recording["joint1.reference.position"].values - recording["joint1.position"].values)
    print(f"{what:22}   largest error {abs(error).max():7.3f} mrad   left at the end {abs(error[-1]):8.5f} mrad")
