"""Measure a robot in its own control loop: a multisine on each motor in turn, the response from torques to positions, the loop's margins.

python frequency_response.py
"""

from pathlib import Path

import flexfmu

file = Path(__file__).with_name("controller_scene.toml")
encoder = {"kind": "encoder", "counts_per_turn": 1e6, "window": 1}
changes = {"shaper": [], "imperfection": [encoder], "effects.joint_friction.coulomb": 0.0, "trajectory.dwell": 1.7}
scene = flexfmu.load_scene(file).replace(changes)


def excited(joint: int) -> flexfmu.Run:
    """A run with 2 N.m RMS on a motor at the end of the motion: sines at 4, 8 ... 400 Hz, which repeat after 0.5 s."""
    multisines = [
        flexfmu.disturbances.noise(
            signal=f"joint{k}.disturbance", standard_deviation=2.0 * (k == joint), band=(2.0, 402.0), components=100,
            start=0.5, sample_time=1e-3,
        )
        for k in (1, 2)
    ]  # fmt: skip
    return flexfmu.run(scene, disturbances=multisines)


# the motors' torque is the controller's and the multisine
torques = [f"joint{k}.torque + joint{k}.disturbance" for k in (1, 2)]
positions = [f"joint{k}.position" for k in (1, 2)]
runs = [excited(joint) for joint in (1, 2)]
plant = flexfmu.frequency_response(runs, torques, positions, period=0.5, between=(0.6, 9.9), band=(1.0, 401.0))
plant.write("plant.csv")
print(plant)
for mode in plant.modes().modes:
    print(f"mode at {mode.frequency:.2f} ± {mode.frequency.error:.2g} Hz, damping {100 * mode.damping_ratio:.2f} %")

# the same loop around the measured robot, and around the model
measured, model = flexfmu.margins(scene, response="plant.csv").worst, flexfmu.margins(scene, poses=1).worst
for name in ("gain_margin", "phase_margin", "delay_margin", "disk_margin"):
    value = getattr(measured, name)
    print(f"{name} {value:.5g} ± {value.error:.1g}, of the model {getattr(model, name):.5g}")
