"""Tune the gains of a PD controller: the smallest tracking error with at most 95 N.m, for payloads of 5.4 to 6.6 kg.

python tune_loop.py
"""

import flexfmu

# a robot with motors, driven by torques; one mode of each proximal link
changes = {
    "effects.proximal_bending": 1,
    "effects.distal_axial": 0,
    "cosimulation.drive": "torque",
    "effects.motor_inertia": 0.1,
    "name": "loop",
}
pd = flexfmu.control.pd(proportional=2e3, derivative=20.0, sample_time=1e-3)
scene = flexfmu.load_scene("barnard2012-6kg").replace({**changes, "controller": [pd]})

if __name__ == "__main__":  # its processes import this script where they aren't forked
    result = flexfmu.tune(
        scene,
        {"pd.kp": (1e3, 1e5), "pd.kd": (10.0, 500.0)},
        minimise="rms_tracking_error",
        subject_to=["peak_torque < 95", "residual_vibration_amplitude < 5 mm"],
        payload_band=0.1,
        trials=40,
        out="tuned",  # the same call continues after Ctrl-C
    )
    given, tuned = (1e3 * result.study.minimise.of(each.figures) for each in (result.given, result.best))
    for key, value in result.values.items():
        print(f"{key} = {value:g}")
    print(f"RMS tracking error {tuned:.3f} mrad, given {given:.3f} mrad, within limits: {result.is_feasible}")
