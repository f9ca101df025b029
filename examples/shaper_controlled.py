"""A shaped motion through a controller that lets the joints give way: shapers calm the links, and need less torque.

python shaper_controlled.py
"""

import flexfmu

controller = flexfmu.control.computed_torque(proportional=6400.0, derivative=160.0, sample_time=0.25e-3)
robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1, "trajectory.duration": 0.35})
KINDS = {"none": [], "zv": [flexfmu.shapers.zv()], "zvd": [flexfmu.shapers.zvd()], "ei": [flexfmu.shapers.ei()]}

print("shaper   drive                    added [ms]   residual [µm]   peak torque [N.m]")
for kind, shapers in KINDS.items():
    for label, controllers in {"perfect": None, "computed torque, 4 kHz": [controller]}.items():
        run = flexfmu.run(robot, controllers=controllers, shapers=shapers)
        found = run.metrics
        residual, torque = found.residual_vibration_amplitude, found.peak_torque_1
        added = run.plan.duration - robot.trajectory.duration
        print(f"{kind:6}   {label:22}   {1e3 * added:10.2f}   {1e6 * residual:13.2f}   {torque:17.2f}")
