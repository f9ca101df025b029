"""The fastest motion through given angles of the motors by toppra, as the robot's motion: exact, piece by piece.

pip install "flexfmu[toppra]"; python toppra_motion.py
"""

import numpy as np
import toppra
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

import flexfmu

toppra.setup_logging("WARNING")
scene = flexfmu.load_scene("barnard2012-6kg")
known = flexfmu.reference_motion(scene).joints

# a spline through seven places of the paper's path, within limits of the motors
places = known.evaluate(np.linspace(0.0, known.duration, 9)[1:-1], 0)[0]
limits = [JointVelocityConstraint([[-15.0, 15.0]] * 2), JointAccelerationConstraint([[-250.0, 250.0]] * 2)]  # rad, s
fastest = TOPPRA(limits, toppra.SplineInterpolator(np.linspace(0.0, 1.0, len(places)), places)).compute_trajectory(0, 0)
motion = flexfmu.motions.from_toppra(fastest)
print(f"{motion.duration:.4f} s, {len(motion.breakpoints)} breakpoints")

# the robot's motion, and a table for scene files: trajectory = { kind = "table", file = "toppra.csv" }
run = flexfmu.run(scene, trajectory=motion)
flexfmu.motions.write_table("toppra.csv", motion)
for name in ("peak_torque_1", "residual_vibration_amplitude"):
    print(name, float(run.metrics[name]))
