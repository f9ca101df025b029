"""PID control with limited torques: the integral brings the robot to its end pose, anti-windup keeps it from going astray.

python controller_pid.py
"""

import warnings

from flexfmu import load_scene, measure_run
from flexfmu.cosim.control.controllers.joints import symmetric
from flexfmu.cosim.control.controllers.pid import BackCalculation, Clamping, Unprotected, pid
from flexfmu.cosim.engine.errors import LoopWarning
from flexfmu.cosim.experiment.parameters import holding_torques
from flexfmu.cosim.experiment.prepared_scene import run_loop

scene = load_scene("barnard2012-6kg").replace(
    {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "trajectory.dwell": 0.5}
)
start = list(holding_torques(scene).values())  # the integral begins where the robot is at rest

warnings.simplefilter("ignore", LoopWarning)  # without protection the loop runs away, as the table shows

for rule in (Unprotected(), Clamping(), BackCalculation(tracking_time=0.01)):
    controller = pid(
        proportional=10e3,
        integral=300e3,
        derivative=100.0,
        sample_time=1e-3,
        limits=symmetric(50.0),
        anti_windup=rule,
        initial_torque=start,
    )
    found = measure_run(run_loop(scene, [controller]))
    settling = found["settling_time"].value
    print(
        f"{type(rule).__name__:16} residual {1e3 * found['residual_vibration_amplitude'].value:8.3f} mm, "
        + ("not settled" if settling is None else f"settled after {1e3 * settling:.0f} ms")
    )
