"""The cascade of an industrial drive: position loop at 1 kHz, velocity loop at 4 kHz, current loop at 16 kHz, with and without feedforward.

python controller_cascade.py
"""

from flexfmu import load_scene, run

robot = load_scene("barnard2012-6kg").replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1})


def cascade(velocity_feedforward: float) -> dict[str, object]:
    """The table of the scene file."""
    return {
        "kind": "cascade",
        "torque_limit": 90.0,
        "sample_time": 1e-3,
        "position": {"proportional": 60.0, "velocity_feedforward": velocity_feedforward},
        "velocity": {"proportional": 120.0, "integral": 6e3, "sample_time": 2.5e-4},
        "current": {"time_constant": 2e-4, "sample_time": 6.25e-5},
    }


torques = {"kind": "feedforward", "sample_time": 1e-3}
for what, controllers in {
    "position error alone": [cascade(0.0)],
    "velocity feedforward": [cascade(1.0)],
    "and torque feedforward": [cascade(1.0), torques],
}.items():
    recording = run(robot.replace({"controller": controllers})).recording
    error = recording["joint1.reference.position"].values - recording["joint1.position"].values
    print(f"{what:22}   tracking error {1e3 * abs(error).max():7.3f} mrad")
