"""An input shaper in three ways: on the joint references, on the motion along the path, and as a slave on sampled references.

Shaped joint references lead the end effector off its path a little; the shaped motion along the path doesn't, and the
sampled shaper is what runs in a real controller.

    python shaper_three_ways.py
"""

import flexfmu

scene = flexfmu.load_scene("barnard2012-6kg").replace({"trajectory.duration": 0.35})

# ZVD for the lowest mode at the end pose, where the residual vibration is
print(f"lowest mode at the end: {flexfmu.modes(scene, 3)[-1].frequencies[0]:.2f} Hz")
ways = {
    "unshaped": [],
    "joints": [flexfmu.shapers.zvd(apply="joints")],
    "path": [flexfmu.shapers.zvd(apply="path")],
    "sampled, 4 kHz": [flexfmu.shapers.zvd(apply="sampled", sample_time=0.25e-3)],
}
for label, shapers in ways.items():
    run = flexfmu.run(scene, shapers=shapers)
    residual, added = run.metrics.residual_vibration_amplitude, run.plan.duration - scene.trajectory.duration
    print(
        f"{label:16} residual {1e6 * residual:8.3f} µm, {1e3 * added:5.2f} ms longer, off the path by {1e3 * run.plan.deviation:.4f} mm"
    )
