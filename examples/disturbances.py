"""What disturbs a robot at rest after its motion: a push at the end effector, band-limited noise, a payload that is dropped.

python disturbances.py
"""

from flexfmu import load_scene, run

pd = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
torques = {"kind": "feedforward", "sample_time": 1e-3}
robot = load_scene("barnard2012-6kg").replace(
    {
        "cosimulation.drive": "torque",
        "effects.motor_inertia": 0.1,
        "trajectory.dwell": 0.4,
        "controller": [pd, torques],
    }
)

for what, disturbances in {
    "nothing": [],
    "a push of 20 N for 50 ms": [
        {"kind": "pulse", "signal": "force.y", "amplitude": 20.0, "start": 0.5, "duration": 0.05}
    ],
    "noise of 2 N, 5 to 50 Hz": [
        {"kind": "noise", "signal": "force.y", "standard_deviation": 2.0, "band": [5.0, 50.0], "seed": 1, "start": 0.5}
    ],
    "the payload is dropped": [{"kind": "payload", "dropped": 0.5}],
}.items():
    recording = run(robot.replace({"disturbance": disturbances})).recording
    late = recording.time > 0.5
    error = 1e3 * (recording["joint1.reference.position"].values - recording["joint1.position"].values)[late]
    print(f"{what:26} tracking error {abs(error).max():7.4f} mrad")
