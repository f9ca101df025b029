"""References for the flexible robot against rigid ones: tables of docs/motions.md.

python benchmarks/flexible_references.py [--damping 0.01] [--loop]
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

import flexfmu

SCENE, PAYLOADS = "barnard2012-6kg", (4.2, 6.0, 7.8)
REFERENCES: dict[str, Any] = {"rigid": "rigid"} | {
    f"flexible, knots {1e3 * spacing:g} ms": {"kind": "flexible", "knot_spacing": spacing}
    for spacing in (0.004, 0.002, 0.001)
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--damping", type=float, default=0.1357, help="modal damping ratio of the links")
    parser.add_argument(
        "--loop", action="store_true", help="motors with a PD controller at 1 kHz instead of perfect ones"
    )
    options = parser.parse_args()
    changes = {"cosimulation.tolerance": 1e-8, "effects.damping.ratio": options.damping}
    scene = flexfmu.load_scene(SCENE).replace(changes)
    if options.loop:
        in_a_loop(scene)
        return
    print("references | error [um] at each payload | residual [um] | torque at 6 kg [N m] | joint jerk [rad/s3]")
    for label, references in REFERENCES.items():
        other = scene.replace({"trajectory.references": references})
        runs = [flexfmu.run(other, parameters={"payload.mass": mass}) for mass in PAYLOADS]
        error, residual = (
            [1e6 * (run.metrics[name] or 0.0) for run in runs]
            for name in ("peak_position_error", "residual_vibration_amplitude")
        )
        torque = max(runs[1].metrics["peak_torque_1"] or 0.0, runs[1].metrics["peak_torque_2"] or 0.0)
        joints = runs[1].plan.joints
        jerk = np.abs(joints.evaluate(np.linspace(0.0, joints.duration, 20001), 3)[3]).max()
        texts = [" / ".join(f"{value:.3g}" for value in each) for each in (error, residual)]
        print(f"{label} | {texts[0]} | {texts[1]} | {torque:.1f} | {jerk:,.0f}")


def in_a_loop(scene: flexfmu.Scene) -> None:
    """Print the table of motors with a controller."""
    print("references | feedforward | tracking error [urad] | error [um] | residual [um]")
    pd = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
    for references in ("rigid", "flexible"):
        for robot in (None, "rigid", "flexible"):
            ahead = [] if robot is None else [{"kind": "feedforward", "robot": robot, "sample_time": 1e-3}]
            driven = {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "controller": [pd, *ahead]}
            run = flexfmu.run(scene.replace({"trajectory.references": references, **driven}))
            names = ("peak_tracking_error_1", "peak_position_error", "residual_vibration_amplitude")
            print(
                f"{references} | {robot} | " + " | ".join(f"{1e6 * (run.metrics[name] or 0.0):.3g}" for name in names)
            )


if __name__ == "__main__":
    main()
