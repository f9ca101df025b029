"""What disturbs a robot at rest after its motion: a push at the end effector, band-limited noise, a payload that is dropped.

python disturbances.py
"""

import flexfmu

robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1, "trajectory.dwell": 0.4})
pd = flexfmu.control.pd(proportional=1e4, derivative=100.0, sample_time=1e-3)
torques = flexfmu.control.feedforward(sample_time=1e-3)

for what, disturbances in {
    "nothing": [],
    "a push of 20 N for 50 ms": [
        flexfmu.disturbances.pulse(signal="force.y", amplitude=20.0, start=0.5, duration=0.05)
    ],
    "noise of 2 N, 5 to 50 Hz": [
        flexfmu.disturbances.noise(signal="force.y", standard_deviation=2.0, band=[5.0, 50.0], seed=1, start=0.5)
    ],
    "the payload is dropped": [flexfmu.disturbances.payload(dropped=0.5)],
}.items():
    recording = flexfmu.run(robot, controllers=[pd, torques], disturbances=disturbances).recording
    late = recording.time > 0.5
    error = 1e3 * (recording["joint1.reference.position"].values - recording["joint1.position"].values)[late]
    print(f"{what:26} tracking error {abs(error).max():7.4f} mrad")
