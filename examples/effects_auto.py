"""Leave the choice of effects to an error estimate: what is in the model, what isn't, what each effect is worth, and a run.

python effects_auto.py
"""

from pathlib import Path

import flexfmu

scene = flexfmu.load_scene(Path(__file__).with_name("effects_auto.toml"))

study = flexfmu.study_effects(scene)
print(study)
print("contribution of each effect to the metric that it changes most, and operations of the model with that change:")
for row in study.rows:
    effect, operations = row.estimate, row.cost.operations - study.cost.operations
    name = f"{effect.effect}: {effect.change}"
    print(
        f"  {'in ' if effect.chosen else 'out'} {name:<70} {100.0 * max(effect.contribution):8.2f} % {operations:+6d}"
    )

# the chosen scene is a scene like any other; flexfmu.run(scene) would choose by itself
run = flexfmu.run(study.scene)
measured = run.metrics
print(f"FMU with {study.cost.states} elastic coordinates, tolerance {run.tolerance:g}:")
for metric in study.choice.of:
    print(f"  {metric} {measured[metric]:.4g}")
