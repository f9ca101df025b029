"""Replay the motion of a log, and compare its measured torques with those of the model.

python replay_log.py
"""

import numpy as np

import flexfmu

scene = flexfmu.load_scene("barnard2012-6kg")

# a stand-in for a log of the drives at 2 kHz: angles and torques, of a robot with 5.7 kg
robot = flexfmu.run(scene, parameters={"payload.mass": 5.7}).recording
time = np.arange(0.0, 0.6, 5e-4)
names = [f"joint{joint}.{signal}" for signal in ("reference.position", "torque") for joint in (1, 2)]
columns = [time, *(np.interp(time, robot.time, robot[name].values) for name in names)]
np.savetxt("log.csv", np.column_stack(columns), delimiter=",", header="time,q11,q21,M1,M2", comments="", fmt="%.9g")

# the replay: which payload did the robot carry?
motion = {"kind": "table", "file": "log.csv"}
replays = [scene.replace({"name": f"{mass:g}kg", "trajectory": motion, "payload.mass": mass}) for mass in (5.7, 6.0)]
found = flexfmu.compare(*replays, measured="log.csv", mapping={"M1": "joint1.torque", "M2": "joint2.torque"})
for name, signals in found.measured.differences.items():
    print(name, *(f"{signal}: {each.root_mean_square:.3f} N.m RMS" for signal, each in signals.items()), sep="   ")
