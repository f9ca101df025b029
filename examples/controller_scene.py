"""A scene file with controllers, a shaper and imperfections, and what each of them contributes.

The same from a shell, with report.html and all: flexfmu run controller_scene.toml

    python controller_scene.py
"""

from pathlib import Path

import flexfmu

scene = flexfmu.load_scene(Path(__file__).with_name("controller_scene.toml"))
variants = {
    "complete": scene,
    "without the shaper": scene.replace({"shaper": []}),
    "without the feedforward": scene.replace({"controller": [scene.controller[0].model_dump()]}),
    "without imperfections": scene.replace({"imperfection": []}),
}

METRICS = ("peak_torque_1", "peak_tracking_error_1", "rms_acceleration_error", "residual_vibration_amplitude")
for label, variant in variants.items():
    found = flexfmu.run(variant).metrics
    print(f"{label:24}", *(f"{flexfmu.display(name, found[name], 4):>14}" for name in METRICS))
