"""A robot of your own: a scene file with other links, material, gravity, blends and damping, and one change of its design.

The same from a shell, with report.html and all: flexfmu run own_robot.toml

    python own_robot.py
"""

from pathlib import Path

from flexfmu.cosim.experiment import run_scene
from flexfmu.cosim.measuring.metric_table import METRICS, display
from flexfmu.cosim.metrics import measure_run
from flexfmu.model.scene_file import load_scene

scene = load_scene(Path(__file__).with_name("own_robot.toml"))
thick = scene.replace({"mechanism.distal.diameter": 0.036, "mechanism.distal.inner_diameter": 0.032})

# the sizes of the links are parameters of the FMU: both robots run through the same one
first = run_scene(scene)
second = run_scene(thick, fmu_path=first.fmu_path)

before, after = measure_run(first), measure_run(second)
print(f"{'':32} {'30 mm tubes':>18} {'36 mm tubes':>18}")
for name, info in METRICS.items():
    print(f"{info.label:32} {display(name, before[name].value):>18} {display(name, after[name].value):>18}")
