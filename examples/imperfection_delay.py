"""How much delay a controller stands: torques that come later and later, and measurements whose delay is known or not.

python imperfection_delay.py
"""

import warnings

from flexfmu import load_scene
from flexfmu.cosim.engine.errors import LoopWarning
from flexfmu.cosim.experiment.prepared_scene import run_scene

warnings.simplefilter("ignore", LoopWarning)  # the longest delay makes the loop unstable

CONTROLLER = {"kind": "computed-torque", "proportional": 3600.0, "derivative": 120.0, "sample_time": 1e-3}
scene = load_scene("barnard2012-6kg").replace(
    {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "controller": [CONTROLLER]}
)

for delay in (0.0, 0.25e-3, 0.5e-3, 1e-3, 2e-3):
    run = run_scene(scene.replace({"imperfection": [{"kind": "delay", "time": delay, "signal": "torque"}]}))
    if run.completed:
        error = run.metrics.peak_tracking_error_1
        print(f"{1e3 * delay:.2f} ms late: tracking error {1e3 * error:.3f} mrad")
    else:  # what was recorded until then is kept
        print(f"{1e3 * delay:.2f} ms late: unstable, {run.recording.time[-1]:.3f} s simulated")

# a measurement that is 0.5 ms old: a controller that knows its time stamp compares it with the reference of that time
for known in (False, True):
    late = {"kind": "delay", "signal": "position", "time": 0.5e-3, "known": known}
    error = run_scene(scene.replace({"imperfection": [late]})).metrics.peak_tracking_error_1
    print(f"position 0.50 ms old, {'known' if known else 'not known'}: tracking error {1e3 * error:.3f} mrad")
