"""Motors that are not ideal: limited torque, limited rate of torque, a dead zone, a current loop that lags.

python imperfection_actuator.py
"""

import flexfmu

robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})
controller = flexfmu.control.computed_torque(proportional=3600.0, derivative=120.0, sample_time=1e-3)

imperfections = {
    "ideal": [],
    "saturation, 80 N.m": [flexfmu.imperfections.saturation(limit=80.0)],
    "rate limit, 5 N.m/ms": [flexfmu.imperfections.rate_limit(rate=5e3)],
    "dead zone, 1 N.m": [flexfmu.imperfections.dead_zone(half_width=1.0)],
    "lag, 0.2 ms": [flexfmu.imperfections.lag(time_constant=0.2e-3)],
}
for label, parts in imperfections.items():
    found = flexfmu.run(robot, controllers=[controller], imperfections=parts).metrics
    print(
        f"{label:22} peak torque {found.peak_torque_1:6.2f} N.m, "
        f"tracking error {1e3 * found.peak_tracking_error_1:7.3f} mrad"
    )
