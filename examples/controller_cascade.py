"""The cascade of an industrial drive: position loop at 1 kHz, velocity loop at 4 kHz, current loop at 16 kHz, with and without feedforward.

python controller_cascade.py
"""

import flexfmu

robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})

loops = {
    "velocity": {"proportional": 120.0, "integral": 6e3, "sample_time": 2.5e-4},
    "current": {"time_constant": 2e-4, "sample_time": 6.25e-5},
    "torque_limit": 90.0,
    "sample_time": 1e-3,
}
error_alone = flexfmu.control.cascade(position={"proportional": 60.0, "velocity_feedforward": 0.0}, **loops)
with_velocity = flexfmu.control.cascade(position={"proportional": 60.0}, **loops)
torques = flexfmu.control.feedforward(sample_time=1e-3)

for what, controllers in {
    "position error alone": [error_alone],
    "velocity feedforward": [with_velocity],
    "and torque feedforward": [with_velocity, torques],
}.items():
    metrics = flexfmu.run(robot, controllers=controllers).metrics
    print(f"{what:22}   tracking error {1e3 * metrics.peak_tracking_error_1:7.3f} mrad")
