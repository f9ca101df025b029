"""H-infinity loop shaping beside a PD controller: bandwidth, sensitivity peak and disk margin of the sampled loops.

python controller_h_infinity.py
"""

from flexfmu import load_scene, margins

# one shape of each proximal link
few = {"effects.proximal_bending": 1, "effects.distal_axial": 0}
robot = load_scene("barnard2012-6kg").replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, **few})
for what, controller in {
    "PD": {"kind": "pd", "proportional": 8e3, "derivative": 80.0, "sample_time": 1e-3},
    "H-infinity, 15 Hz": {"kind": "h-infinity", "bandwidth": 15.0, "sample_time": 1e-3},
    "H-infinity, 30 Hz": {"kind": "h-infinity", "bandwidth": 30.0, "sample_time": 1e-3},
}.items():
    worst = margins(robot.replace({"controller": [controller]}), poses=2).worst
    print(f"{what:17}   sensitivity peak {worst.sensitivity_peak:6.2f}   disk margin {worst.disk_margin:5.2f}")
