"""H-infinity loop shaping beside a PD controller: bandwidth, sensitivity peak and disk margin of the sampled loops.

python controller_h_infinity.py
"""

import flexfmu

# one shape of each proximal link
few = {"effects.proximal_bending": 1, "effects.distal_axial": 0}
robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1, **few})
for what, controller in {
    "PD": flexfmu.control.pd(proportional=8e3, derivative=80.0, sample_time=1e-3),
    "H-infinity, 15 Hz": flexfmu.control.h_infinity(bandwidth=15.0, sample_time=1e-3),
    "H-infinity, 30 Hz": flexfmu.control.h_infinity(bandwidth=30.0, sample_time=1e-3),
}.items():
    worst = flexfmu.margins(robot, poses=2, controllers=[controller]).worst
    print(f"{what:17}   sensitivity peak {worst.sensitivity_peak:6.2f}   disk margin {worst.disk_margin:5.2f}")
