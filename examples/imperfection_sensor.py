"""Angles that are not quite known: quantised, noisy, sampled with jitter, behind a play, and from encoders that give the rate too.

The same seed gives the same numbers in every run, in Python and in exported FMUs.

    python imperfection_sensor.py
"""

from flexfmu import load_scene
from flexfmu.cosim.experiment.prepared_scene import run_scene

CONTROLLER = {"kind": "computed-torque", "proportional": 3600.0, "derivative": 120.0, "sample_time": 1e-3}
scene = load_scene("barnard2012-6kg").replace(
    {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "controller": [CONTROLLER]}
)

imperfections = {
    "ideal": [],
    "quantisation, 10 µrad": [{"kind": "quantisation", "resolution": 1e-5}],
    "noise, 10 µrad": [{"kind": "noise", "standard_deviation": 1e-5, "seed": 1}],
    "jitter of the rate, 0.1 ms": [{"kind": "jitter", "signal": "velocity", "time": 1e-4, "seed": 1}],
    "backlash, 20 µrad": [{"kind": "backlash", "gap": 2e-5, "signal": "position"}],
    "encoder, 1e6 counts": [{"kind": "encoder", "counts_per_turn": 1e6}],
}
for label, sections in imperfections.items():
    found = run_scene(scene.replace({"imperfection": sections})).metrics
    print(
        f"{label:27} RMS tracking error {1e6 * found.rms_tracking_error_1:7.2f} µrad, "
        f"RMS residual {1e6 * found.residual_vibration_rms:6.2f} µm"
    )
