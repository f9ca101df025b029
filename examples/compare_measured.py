"""Compare the torques of a log with two simulations: which payload did the robot carry?

python compare_measured.py
"""

import csv

import numpy as np

import flexfmu

scene = flexfmu.load_scene("barnard2012-0.1kg")

# a stand-in for a log of the drives: 2 kHz, mN.m, noise, a clock that is 12.3456 ms late; the robot carries 0.3 kg
robot = flexfmu.run(scene, parameters={"payload.mass": 0.3}).recording
time = np.arange(0.0, 0.6, 5e-4)
noise = np.random.default_rng(0)
torques = [np.interp(time - 0.0123456, robot.time, robot[f"joint{i}.torque"].values) for i in (1, 2)]
with open("log.csv", "w", newline="") as file:
    writer = csv.writer(file)
    writer.writerow(["t [ms]", "M1 [mN.m]", "M2 [mN.m]"])
    for t, *both in zip(1e3 * time, *torques, strict=True):
        writer.writerow([f"{t:.3f}", *(f"{1e3 * each + 100.0 * noise.standard_normal():.3f}" for each in both)])

# the comparison
runs = [flexfmu.run(scene.replace({"name": f"with-{mass}-kg", "payload.mass": mass})) for mass in (0.3, 0.1)]
found = flexfmu.compare(*runs, measured="log.csv", mapping={"M1": "joint1.torque", "M2": "joint2.torque"})
delay = found.measured.delay
print(f"the log is {1e3 * delay.seconds:.4f} ms late, with a standard error of {1e3 * delay.error:.4f} ms")
for name, signals in found.measured.differences.items():
    print(name, *(f"{signal}: {each.root_mean_square:.3f} N.m RMS" for signal, each in signals.items()), sep="   ")
found.write("comparison")
