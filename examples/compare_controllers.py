"""Four loops for one robot in one table: PD, stiffer PD, PD with the rigid torques added, and the same with a shaper.

python compare_controllers.py
"""

import flexfmu

# a robot with motors, driven by torques; one mode of each proximal link
changes = {
    "effects.proximal_bending": 1,
    "effects.distal_axial": 0,
    "cosimulation.drive": "torque",
    "effects.motor_inertia": 0.1,
    "trajectory.duration": 0.3,
}
robot = flexfmu.load_scene("barnard2012-6kg").replace(changes)
pd = flexfmu.control.pd(proportional=5e3, derivative=50.0, sample_time=5e-4)
feedforward = flexfmu.control.feedforward(sample_time=5e-4)
shaper = flexfmu.shapers.zv(apply="path", modes=[{"frequency": 58.0, "ratio": 0.14}])

soft = robot.replace({"name": "pd", "controller": [pd]})
scenes = [
    soft,
    soft.replace({"name": "stiff", "pd.kp": 2e4, "pd.kd": 150.0}),
    soft.replace({"name": "with-torques", "controller": [pd, feedforward]}),
    soft.replace({"name": "shaped", "controller": [pd, feedforward], "shaper": [shaper]}),
]

# the robot carries up to 20 % more or less than they assume
found = flexfmu.compare(*scenes, payload_band=0.2)
print("loop", "tracking mrad", "with other payloads", "residual um", "with other payloads", sep=",")
for run in found.runs:
    nominal, worst = run.metrics, run.band.worst
    tracking = [1e3 * each for each in (nominal["rms_tracking_error_1"].value, worst["rms_tracking_error_1"])]
    residual = [
        1e6 * each for each in (nominal["residual_vibration_amplitude"].value, worst["residual_vibration_amplitude"])
    ]
    print(run.name, *(f"{each:.3g}" for each in tracking + residual), sep=",")
found.write("comparison")
