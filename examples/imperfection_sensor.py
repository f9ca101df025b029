"""Angles that are not quite known: quantised, noisy, sampled with jitter, behind a play, and from encoders that give the rate too.

The same seed gives the same numbers in every run, in Python and in exported FMUs.

    python imperfection_sensor.py
"""

import flexfmu
from flexfmu import imperfections

robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})
controller = flexfmu.control.computed_torque(proportional=3600.0, derivative=120.0, sample_time=1e-3)

sensors = {
    "ideal": [],
    "quantisation, 10 µrad": [imperfections.quantisation(resolution=1e-5)],
    "noise, 10 µrad": [imperfections.noise(standard_deviation=1e-5, seed=1)],
    "jitter of the rate, 0.1 ms": [imperfections.jitter(signal="velocity", time=1e-4, seed=1)],
    "backlash, 20 µrad": [imperfections.backlash(gap=2e-5, signal="position")],
    "encoder, 1e6 counts": [imperfections.encoder(counts_per_turn=1e6)],
}
for label, parts in sensors.items():
    found = flexfmu.run(robot, controllers=[controller], imperfections=parts).metrics
    print(
        f"{label:27} RMS tracking error {1e6 * found.rms_tracking_error_1:7.2f} µrad, "
        f"RMS residual {1e6 * found.residual_vibration_rms:6.2f} µm"
    )
