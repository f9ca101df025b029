"""Iterative learning: the torque that a repeated motion needs, learned cycle by cycle on top of PD control.

python controller_learning.py
"""

import numpy as np

from flexfmu import load_scene
from flexfmu.cosim.control.controllers.iterative_learning import iterative_learning
from flexfmu.cosim.control.controllers.pid import pd
from flexfmu.cosim.experiment.cycles import repeated
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.prepared_scene import run_loop

scene = load_scene("barnard2012-6kg").replace(
    {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "trajectory.duration": 0.6, "trajectory.dwell": 0.15}
)
CYCLES, SAMPLE_TIME = 8, 1e-3
motion = repeated(plan(scene), CYCLES)  # there and back, 1.5 s a cycle
samples = round(motion.joints.period / SAMPLE_TIME)

feedback = pd(proportional=10e3, derivative=100.0, sample_time=SAMPLE_TIME)
# with the filter errors shrink for ever; without it those at 198 Hz grow by 3 % in each cycle, which shows after fifty of them
learning = iterative_learning(4e3, samples, sample_time=SAMPLE_TIME, shift=4, q_filter=47.6)
run = run_loop(scene, [feedback, learning], motion=motion)

time = run.recording.time
for cycle in range(CYCLES):
    part = (time >= cycle * motion.joints.period) & (time < (cycle + 1) * motion.joints.period)
    errors = [
        run.recording[f"joint{joint}.reference.position"].values - run.recording[f"joint{joint}.position"].values
        for joint in (1, 2)
    ]
    rms = np.sqrt(np.mean(np.square(errors)[:, part]))
    print(f"cycle {cycle + 1}: tracking error {1e3 * rms:.4f} mrad RMS")
