"""A loop with each kind of filter: what it does to vibration, tracking error and delay margin.

python filter_kinds.py
"""

import flexfmu

# one shape of each proximal link
few = {"effects.proximal_bending": 1, "effects.distal_axial": 0}
robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1, **few})
controllers = [
    flexfmu.control.pd(proportional=5e3, derivative=60.0, sample_time=5e-4),
    flexfmu.control.feedforward(sample_time=5e-4),
]
for what, filters in {
    "none": [],
    "low-pass of the velocity, 400 Hz": [flexfmu.filters.low_pass(frequency=400.0, signal="velocity")],
    "lead-lag of the torque": [flexfmu.filters.lead_lag(zero=100.0, pole=200.0, signal="torque")],
    "setpoint filter, 40 Hz": [flexfmu.filters.low_pass(frequency=40.0, signal="reference")],
    "biquad in place of a notch": [
        flexfmu.filters.biquad(numerator=[1.0, 60.0, 9e4], denominator=[1.0, 300.0, 9e4], signal="torque")
    ],
}.items():
    loop = {"controllers": controllers, "filters": filters}
    found, worst = flexfmu.run(robot, **loop).metrics, flexfmu.margins(robot, poses=1, **loop).worst
    print(
        f"{what:33} vibration {1e6 * found.residual_vibration_amplitude:8.2f} µm   "
        f"tracking error {1e3 * found.peak_tracking_error_1:6.3f} mrad   delay margin {1e3 * worst.delay_margin:5.2f} ms"
    )
