"""Jerk-limited motion of the motors by ruckig, as the robot's motion: exact, piece by piece.

pip install "flexfmu[ruckig]"; python ruckig_motion.py
"""

import ruckig

import flexfmu

scene = flexfmu.load_scene("barnard2012-6kg")
known = flexfmu.reference_motion(scene).joints

# from the start of the paper's path to its end, within limits of the motors
limits = ruckig.InputParameter(2)
limits.current_position, limits.target_position = known.evaluate([0.0, known.duration], 0)[0].tolist()
limits.max_velocity, limits.max_acceleration, limits.max_jerk = [15.0, 15.0], [250.0, 250.0], [1e4, 1e4]  # rad, s
fastest = ruckig.Trajectory(2)
ruckig.Ruckig(2).calculate(limits, fastest)
motion = flexfmu.motions.from_ruckig(fastest)
print(f"{motion.duration:.4f} s, {len(motion.breakpoints)} breakpoints")

# the robot's motion, and a table for scene files: trajectory = { kind = "table", file = "ruckig.csv" }
run = flexfmu.run(scene, trajectory=motion)
flexfmu.motions.write_table("ruckig.csv", motion)
for name in ("peak_torque_1", "residual_vibration_amplitude"):
    print(name, float(run.metrics[name]))
