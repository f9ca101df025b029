"""How much delay a controller stands: torques that come later and later, and measurements whose delay is known or not.

python imperfection_delay.py
"""

import warnings

import flexfmu

warnings.simplefilter("ignore", flexfmu.LoopWarning)  # the longest delay makes the loop unstable

robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})
controller = flexfmu.control.computed_torque(proportional=3600.0, derivative=120.0, sample_time=1e-3)

for delay in (0.0, 0.25e-3, 0.5e-3, 1e-3, 2e-3):
    late = flexfmu.imperfections.delay(time=delay, signal="torque")
    run = flexfmu.run(robot, controllers=[controller], imperfections=[late])
    if run.completed:
        error = run.metrics.peak_tracking_error_1
        print(f"{1e3 * delay:.2f} ms late: tracking error {1e3 * error:.3f} mrad")
    else:  # what was recorded until then is kept
        print(f"{1e3 * delay:.2f} ms late: unstable, {run.recording.time[-1]:.3f} s simulated")

# a measurement that is 0.5 ms old: a controller that knows its time stamp compares it with the reference of that time
for known in (False, True):
    late = flexfmu.imperfections.delay(time=0.5e-3, signal="position", known=known)
    error = flexfmu.run(robot, controllers=[controller], imperfections=[late]).metrics.peak_tracking_error_1
    print(f"position 0.50 ms old, {'known' if known else 'not known'}: tracking error {1e3 * error:.3f} mrad")
