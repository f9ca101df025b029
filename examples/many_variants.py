"""Many variants of a scene through one FMU in one process: payloads times durations, and what each of them needs.

python many_variants.py
"""

from itertools import product

import flexfmu

PAYLOADS = (0.0, 2.0, 4.0, 6.0, 8.0)
DURATIONS = (0.25, 0.3, 0.43)
TORQUE = "joint1.torque"

scene = flexfmu.load_scene("barnard2012-6kg").replace({"trajectory.dwell": 0.0})
variants = [{"payload.mass": mass, "trajectory.duration": time} for time, mass in product(DURATIONS, PAYLOADS)]


def peak_torque(run) -> float:
    """Of the first motor at the communication points [N·m]."""
    return float(abs(run.recording[TORQUE].values).max())


results = flexfmu.run_variants(
    scene, variants, peak_torque, communication_step=1e-3, tolerance=1e-3, record=flexfmu.Selection([TORQUE], order=0)
)

print("peak torque [N·m]" + "".join(f"{mass:8.1f} kg" for mass in PAYLOADS))
for duration in DURATIONS:
    cells = [
        "failed" if each.value is None else f"{each.value:.2f}"
        for each in results
        if each.changes["trajectory.duration"] == duration
    ]
    print(f"{duration:15.2f} s " + "".join(f"{cell:>11}" for cell in cells))
