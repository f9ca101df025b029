"""A robot of your own: a scene file with other links, material, gravity, blends and damping, and one change of its design.

The same from a shell, with report.html and all: flexfmu run own_robot.toml

    python own_robot.py
"""

from pathlib import Path

import flexfmu

METRICS = (
    "peak_torque_1", "peak_torque_2", "peak_position_error", "rms_acceleration_error", "end_position_error",
    "residual_vibration_amplitude", "settling_time",
)  # fmt: skip

scene = flexfmu.load_scene(Path(__file__).with_name("own_robot.toml"))
thick = scene.replace({"mechanism.distal.diameter": 0.036, "mechanism.distal.inner_diameter": 0.032})

# the sizes of the links are parameters of the FMU: both robots run through the same one
first = flexfmu.run(scene)
second = flexfmu.run(thick, fmu=first.fmu_path)

before, after = first.metrics, second.metrics
print(f"{'':32} {'30 mm tubes':>18} {'36 mm tubes':>18}")
for name in METRICS:
    print(f"{before[name].label:32} {flexfmu.display(name, before[name]):>18} {flexfmu.display(name, after[name]):>18}")
