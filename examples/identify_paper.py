"""Find damping and base distance again, which the paper leaves out, from its own table of torques, deflections and acceleration errors.

python identify_paper.py

Barnard, Briot, Caro, "Trajectory Generation for High Speed Pick-and-Place Robots", ESDA 2012, Table 7 (6 kg, 0.43 s).
"""

import csv

import flexfmu

PROFILES = {
    '{ kind = "poly7" }': ((73.634, 2.7168), (70.046, 3.3724)),
    '{ kind = "bang-bang" }': ((56.084, 4.5245), (50.848, 4.7786)),
    '{ kind = "trapezoidal", ramp = 0.25 }': ((75.208, 6.0193), (74.605, 6.3989)),
    '{ kind = "trapezoidal", ramp = 0.125 }': ((125.45, 10.572), (124.45, 10.731)),
}
"""Profile → torque of joint 1 [N.m] and RMS acceleration error [m/s2] with Lamé curves, then with clothoids."""

with open("table7.csv", "w", newline="") as file:
    writer = csv.writer(file)
    writer.writerow(["trajectory.profile", "trajectory.blend.kind", "peak_torque_1", "rms_acceleration_error"])
    for profile, cells in PROFILES.items():
        for blend, figures in zip(("lame", "clothoid"), cells, strict=True):
            writer.writerow([profile, f'"{blend}"', *figures])

# metrics have five digits with communication points every millisecond, too
scene = flexfmu.load_scene("barnard2012-6kg").replace({"cosimulation.step": 1e-3})
# from other first values
found = flexfmu.identify(scene, "table7.csv", {"base_half_distance": 0.095, "damping.ratio": 0.1})
for each in found.estimates:
    low, high = each.interval
    print(f"{each.name}: {each.value:.4f} ± {each.standard_error:.4f} {each.unit}, 95 % from {low:.4f} to {high:.4f}")
