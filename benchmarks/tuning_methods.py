"""Descents of `flexfmu tune`: the best figure found, trials and processor time.

python benchmarks/tuning_methods.py
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import flexfmu

DRIVEN: dict[str, Any] = {
    "effects.proximal_bending": 1,
    "effects.distal_axial": 0,
    "cosimulation.drive": "torque",
    "effects.motor_inertia": 0.1,
}
PD = {"kind": "pd", "proportional": 2e3, "derivative": 20.0, "sample_time": 1e-3}
KP, KD = (1e3, 1e5), (10.0, 500.0)
ROBOT = flexfmu.load_scene("barnard2012-6kg").replace(DRIVEN)
WITH_PD = ROBOT.replace({"controller": [PD]})
CASCADE = ROBOT.replace({"controller": [flexfmu.start_gains(WITH_PD, "cascade", 10.0)]})
ENCODERS = flexfmu.load_scene(Path(__file__).parents[1] / "examples" / "controller_scene.toml")

CASES: dict[str, tuple[Any, Mapping[str, tuple[float, float]], dict[str, Any]]] = {
    "PD, 2 keys": (WITH_PD, {"pd.kp": KP, "pd.kd": KD}, {"subject_to": ["peak_torque < 95"]}),
    "PD, 4 keys": (
        WITH_PD,
        {f"pd.{key}[{joint}]": ends for key, ends in (("kp", KP), ("kd", KD)) for joint in (0, 1)},
        {"subject_to": ["peak_torque < 95"]},
    ),
    "cascade, 4 keys": (
        CASCADE,
        {
            "cascade.position.kp": (20.0, 200.0),
            "cascade.velocity.kp": (5.0, 500.0),
            "cascade.velocity.ki": (10.0, 5e3),
            "cascade.position.velocity_feedforward": (0.5, 1.2),
        },
        {"subject_to": ["peak_torque < 95"]},
    ),
    "PD and encoders, tracking": (ENCODERS, {"pd.kp": KP, "pd.kd": KD}, {}),
    "PD and encoders, residual": (
        ENCODERS,
        {"pd.kp": KP, "pd.kd": KD},
        {"minimise": "residual_vibration_amplitude", "subject_to": ["peak_tracking_error < 5 mrad"]},
    ),
    "PD and encoders, settling": (
        ENCODERS,
        {"pd.kp": KP, "pd.kd": KD},
        {"minimise": "settling_time", "subject_to": ["peak_tracking_error < 5 mrad"]},
    ),
}


def processor_time() -> float:
    """Of this process and the ended ones that it began [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def main() -> int:
    """Print a line for each loop."""
    for name, (scene, over, wishes) in CASES.items():
        begun = processor_time()
        result = flexfmu.tune(scene, over, **wishes)
        goal = result.study.minimise
        print(
            f"{name:27}{goal.name} {goal.shown(goal.of(result.best.figures)):>12}, {len(result.trials):3} trials, "
            f"{processor_time() - begun:5.1f} s{'' if result.is_feasible else ', beyond limits'}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
