"""A shaped motion through a controller that lets the joints give way: shapers calm the links, and need less torque.

python shaper_controlled.py
"""

from flexfmu import load_scene
from flexfmu.cosim.experiment.prepared_scene import run_scene

CONTROLLER = {"kind": "computed-torque", "proportional": 6400.0, "derivative": 160.0, "sample_time": 0.25e-3}
scene = load_scene("barnard2012-6kg").replace(
    {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "trajectory.duration": 0.35}
)

print("shaper   drive                    added [ms]   residual [µm]   peak torque [N.m]")
for kind in (None, "zv", "zvd", "ei"):
    shaped = scene.replace({"shaper": [{"kind": kind}] if kind else []})
    variants = {
        "perfect": shaped.replace({"cosimulation.drive": "motion"}),
        "computed torque, 4 kHz": shaped.replace({"controller": [CONTROLLER]}),
    }
    for label, variant in variants.items():
        run = run_scene(variant)
        found = run.metrics
        residual, torque = found.residual_vibration_amplitude, found.peak_torque_1
        added = run.plan.duration - scene.trajectory.duration
        print(f"{kind or 'none':6}   {label:22}   {1e3 * added:10.2f}   {1e6 * residual:13.2f}   {torque:17.2f}")
