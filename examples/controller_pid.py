"""PID control with limited torques: the integral brings the robot to its end pose, anti-windup keeps it from going astray.

python controller_pid.py
"""

import math
import warnings

import flexfmu

robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1, "trajectory.dwell": 0.5})

warnings.simplefilter("ignore", flexfmu.LoopWarning)  # without protection the loop runs away, as the table shows

for label, rule in {
    "unprotected": "none",
    "clamping": "clamping",
    "back-calculation": {"kind": "back-calculation", "tracking_time": 0.01},
}.items():
    controller = flexfmu.control.pid(
        proportional=10e3, integral=300e3, derivative=100.0, sample_time=1e-3, torque_limit=50.0, anti_windup=rule
    )
    found = flexfmu.run(robot, controllers=[controller]).metrics
    settling = found.settling_time
    print(
        f"{label:16} residual {1e3 * found.residual_vibration_amplitude:8.3f} mm, "
        + ("not settled" if math.isnan(settling) else f"settled after {1e3 * settling:.0f} ms")
    )
