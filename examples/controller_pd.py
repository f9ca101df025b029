"""PD control of the joints, alone and with the rigid torques of the motion as feedforward.

python controller_pd.py
"""

from flexfmu import load_scene
from flexfmu.cosim.control.controllers.computed_torque import inverse_dynamics_feedforward
from flexfmu.cosim.control.controllers.pid import pd
from flexfmu.cosim.experiment.prepared_scene import run_loop
from flexfmu.model.numeric import inverse_dynamics

# flexible links alone are next to massless for the motors at high frequency: real ones have an inertia of their own
scene = load_scene("barnard2012-6kg").replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1})

feedback = pd(proportional=10e3, derivative=100.0, sample_time=1e-3)  # N.m/rad, N.m.s/rad
feedforward = inverse_dynamics_feedforward(inverse_dynamics(scene), sample_time=1e-3)

for label, controllers in (("PD", [feedback]), ("PD and feedforward", [feedback, feedforward])):
    run = run_loop(scene, controllers)
    found = run.metrics
    tracking, torque = found.peak_tracking_error_1, found.peak_torque_1
    print(f"{label:20} tracking error {1e3 * tracking:.3f} mrad, peak torque {torque:.2f} N.m")
