"""A payload that is 30 % heavier than the controllers assume: rigid torques as feedforward, and an observer for what they lack.

python controller_disturbance_observer.py
"""

from flexfmu import load_scene, run

robot = load_scene("barnard2012-6kg").replace(
    {
        "cosimulation.drive": "torque",
        "effects.motor_inertia": 0.1,
        "trajectory.dwell": 0.3,
        "imperfection": [{"kind": "payload-error", "relative": 0.3}],
    }
)
pd = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
gravity = {"kind": "gravity-feedforward", "sample_time": 1e-3}
torques = {"kind": "feedforward", "sample_time": 1e-3}
observer = {"kind": "disturbance-observer", "time_constant": 0.01, "sample_time": 1e-3}

for what, controllers in {
    "PD": [pd],
    "with gravity": [pd, gravity],
    "with all torques": [pd, torques],
    "with an observer, too": [pd, torques, observer],
}.items():
    recording = run(robot.replace({"controller": controllers})).recording
    error = 1e3 * (recording["joint1.reference.position"].values - recording["joint1.position"].values)
    print(f"{what:22}   largest error {abs(error).max():7.3f} mrad   left at the end {abs(error[-1]):8.5f} mrad")
