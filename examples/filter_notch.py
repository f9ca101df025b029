"""A notch in the torque, tuned to the robot's first resonance by its name: what it does to the margins of the loop.

python filter_notch.py
"""

import flexfmu

robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})
pd = flexfmu.control.pd(proportional=5e3, derivative=60.0, sample_time=5e-4)
for depth in (1.0, 0.3, 0.1):
    notch = flexfmu.filters.notch(at="resonance 1", damping=0.3, depth=depth)
    worst = flexfmu.margins(robot, poses=1, controllers=[pd], filters=[notch]).worst
    print(f"depth {depth:.1f}   gain margin {worst.gain_margin:5.2f}   delay margin {1e3 * worst.delay_margin:5.2f} ms")
