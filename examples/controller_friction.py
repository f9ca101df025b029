"""Friction in the joints, and what its compensation saves: by the reference's velocity, by the measured one, with wrong coefficients.

python controller_friction.py
"""

import flexfmu

robot = flexfmu.load_scene("barnard2012-6kg").replace(
    {
        "effects.motor_inertia": 0.1,
        "effects.joint_friction": {"viscous": 1.0, "coulomb": 3.0},
        "trajectory.duration": 1.5,  # slowly: the torques are those of gravity and friction
    }
)
pd = flexfmu.control.pd(proportional=1e4, derivative=100.0, sample_time=1e-3)
gravity = flexfmu.control.gravity_feedforward(sample_time=1e-3)  # control.feedforward would have friction in it already


def friction(**options):
    return flexfmu.control.friction_compensation(**{"viscous": 1.0, "coulomb": 3.0, "sample_time": 1e-3} | options)


for what, controllers in {
    "without": [pd, gravity],
    "with the reference": [pd, gravity, friction()],
    "with the measurement": [pd, gravity, friction(motion="measured")],
    "half of it": [pd, gravity, friction(viscous=0.5, coulomb=1.5)],
}.items():
    metrics = flexfmu.run(robot, controllers=controllers).metrics
    print(f"{what:21}   RMS tracking error {1e3 * metrics.rms_tracking_error_1:7.4f} mrad")
