"""Motors that are not ideal: limited torque, limited rate of torque, a dead zone, a current loop that lags.

python imperfection_actuator.py
"""

from flexfmu import load_scene
from flexfmu.cosim.experiment.prepared_scene import run_scene

CONTROLLER = {"kind": "computed-torque", "proportional": 3600.0, "derivative": 120.0, "sample_time": 1e-3}
scene = load_scene("barnard2012-6kg").replace(
    {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "controller": [CONTROLLER]}
)

imperfections = {
    "ideal": [],
    "saturation, 80 N.m": [{"kind": "saturation", "limit": 80.0}],
    "rate limit, 5 N.m/ms": [{"kind": "rate-limit", "rate": 5e3}],
    "dead zone, 1 N.m": [{"kind": "dead-zone", "half_width": 1.0}],
    "lag, 0.2 ms": [{"kind": "lag", "time_constant": 0.2e-3}],
}
for label, sections in imperfections.items():
    found = run_scene(scene.replace({"imperfection": sections})).metrics
    print(
        f"{label:22} peak torque {found.peak_torque_1:6.2f} N.m, "
        f"tracking error {1e3 * found.peak_tracking_error_1:7.3f} mrad"
    )
