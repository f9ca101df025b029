"""Iterative learning: the torque that a repeated motion needs, learned cycle by cycle on top of PD control.

python controller_learning.py
"""

import numpy as np

import flexfmu

CYCLES = 8
robot = flexfmu.load_scene("barnard2012-6kg").replace(
    {"effects.motor_inertia": 0.1, "trajectory.duration": 0.6, "trajectory.dwell": 0.15}
)
feedback = flexfmu.control.pd(proportional=10e3, derivative=100.0, sample_time=1e-3)
# with the filter errors shrink for ever; without it those at 198 Hz grow by 3 % in each cycle, which shows after fifty of them
learning = flexfmu.control.learning(gain=4e3, lead=4, q_filter=47.6, cycles=CYCLES, sample_time=1e-3)
run = flexfmu.run(robot, controllers=[feedback, learning])  # there and back, 1.5 s a cycle

time, period = run.recording.time, run.plan.repetition.period
for cycle in range(CYCLES):
    part = (time >= cycle * period) & (time < (cycle + 1) * period)
    errors = [
        run.recording[f"joint{joint}.reference.position"].values - run.recording[f"joint{joint}.position"].values
        for joint in (1, 2)
    ]
    rms = np.sqrt(np.mean(np.square(errors)[:, part]))
    print(f"cycle {cycle + 1}: tracking error {1e3 * rms:.4f} mrad RMS")
