"""The robot carries something else than its controller believes.

python imperfection_payload.py
"""

from flexfmu import display, load_scene
from flexfmu.cosim.experiment.prepared_scene import run_scene

CONTROLLER = {"kind": "computed-torque", "proportional": 6400.0, "derivative": 160.0, "sample_time": 1e-3}
scene = load_scene("barnard2012-6kg").replace(
    {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "controller": [CONTROLLER]}
)

METRICS = ("peak_torque_1", "peak_tracking_error_1", "residual_vibration_amplitude", "settling_time")
for relative in (-0.3, -0.1, 0.0, 0.1, 0.3):
    run = run_scene(scene.replace({"imperfection": [{"kind": "payload-error", "relative": relative}]}))
    found = run.metrics
    print(f"{run.robot.payload.mass:.1f} kg", *(f"{display(name, found[name], 4):>14}" for name in METRICS))
