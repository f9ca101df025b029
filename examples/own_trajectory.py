"""Trajectories on their own, for any robot or drive: they need NumPy and SciPy, no model and no FMU.

python own_trajectory.py
"""

import numpy as np

from flexfmu.trajectories import ClothoidPair, PickAndPlacePath, TaskTrajectory, Trapezoidal

# up 25 mm, 305 mm to the right, down again; corners of 25 mm x 30 mm with continuous curvature
path = PickAndPlacePath(start=(0.0, 0.0), lift=(0.0, 1.0), height=0.025, width=0.305, blend=ClothoidPair(0.025, 0.030))
motion = TaskTrajectory(path, Trapezoidal(ramp=0.25), duration=0.4)
print(f"path of {1e3 * path.length:.3f} mm, from {path.start} to {path.end} m")

# position and derivatives of any order, for all instants at once: (order + 1, instants, 2)
time = np.linspace(0.0, motion.duration, 1001)
position, velocity, acceleration, jerk, snap = motion.evaluate(time, order=4)
print(f"top speed {np.linalg.norm(velocity, axis=1).max():.4f} m/s")

# where the motion is not smooth it has two sides
print("breakpoint    |acceleration| before    after [m/s2]")
for instant in motion.breakpoints:
    before, after = (np.linalg.norm(motion.evaluate(instant, 2, side)[2, 0]) for side in ("left", "right"))
    print(f"{instant:8.5f} s {before:17.4f} {after:17.4f}")
