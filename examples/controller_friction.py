"""Friction in the joints, and what its compensation saves: by the reference's velocity, by the measured one, with wrong coefficients.

python controller_friction.py
"""

from flexfmu import load_scene, run

robot = load_scene("barnard2012-6kg").replace(
    {
        "cosimulation.drive": "torque",
        "effects.motor_inertia": 0.1,
        "effects.joint_friction": {"viscous": 1.0, "coulomb": 3.0},
        "trajectory.duration": 1.5,  # slowly: the torques are those of gravity and friction
    }
)
pd = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
gravity = {"kind": "gravity-feedforward", "sample_time": 1e-3}  # kind = "feedforward" has friction in it already
friction = {"kind": "friction-compensation", "viscous": 1.0, "coulomb": 3.0, "sample_time": 1e-3}

for what, controllers in {
    "without": [pd, gravity],
    "with the reference": [pd, gravity, friction],
    "with the measurement": [pd, gravity, {**friction, "motion": "measured"}],
    "half of it": [pd, gravity, {**friction, "viscous": 0.5, "coulomb": 1.5}],
}.items():
    metrics = run(robot.replace({"controller": controllers})).metrics
    print(f"{what:21}   RMS tracking error {1e3 * metrics.rms_tracking_error_1:7.4f} mrad")
