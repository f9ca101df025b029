"""One FMU, many payloads: what is an FMI parameter needs no new build, and the static start follows by itself.

python payload_sweep.py
"""

import flexfmu

scene = flexfmu.load_scene("barnard2012-6kg")
fmu = flexfmu.build(scene)

print("payload   peak torque   peak deviation   residual vibration")
for mass in (0.0, 1.0, 2.0, 4.0, 6.0, 8.0):
    run = flexfmu.run(scene.replace({"payload.mass": mass}), fmu=fmu, communication_step=1e-3)
    metrics = run.metrics
    print(
        f"{mass:4.1f} kg {metrics.peak_torque_1:9.2f} N.m {1e3 * metrics.peak_position_error:12.4f} mm"
        f" {1e6 * metrics.residual_vibration_amplitude:14.2f} µm"
    )
