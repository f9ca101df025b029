"""An input shaper in three ways: on the joint references, on the motion along the path, and as a slave on sampled references.

Shaped joint references lead the end effector off its path a little; the shaped motion along the path doesn't, and the
sampled shaper is what runs in a real controller.

    python shaper_three_ways.py
"""

from flexfmu import load_scene
from flexfmu.cosim.control.shapers import Shaper
from flexfmu.cosim.experiment.planning import deviation, plan
from flexfmu.cosim.experiment.prepared_scene import run_loop
from flexfmu.model.modes import damped_modes
from flexfmu.trajectories.shapers import Oscillator, zero_vibration

scene = load_scene("barnard2012-6kg").replace({"trajectory.duration": 0.35})
motion = plan(scene)

# the lowest mode at the end pose, where the residual vibration is
modes = damped_modes(scene, motion.joints.evaluate(motion.duration, 0)[0, 0])
mode = Oscillator(modes.frequencies[0], modes.ratios[0])
zvd = zero_vibration(mode, derivatives=1)
print(
    f"ZVD for {mode.frequency:.2f} Hz, ratio {mode.ratio:.4f}: impulses at 0, "
    + ", ".join(f"{1e3 * t:.2f}" for t in zvd.times[1:])
    + " ms"
)

ways = {
    "unshaped": [],
    "joints": [Shaper(zvd, "joints")],
    "path": [Shaper(zvd, "path")],
    "sampled, 4 kHz": [Shaper(zvd, "sampled", sample_time=0.25e-3)],
}
for label, shapers in ways.items():
    run = run_loop(scene, shapers=shapers)
    residual = run.metrics.residual_vibration_amplitude
    added = run.plan.duration - motion.duration
    print(
        f"{label:16} residual {1e6 * residual:8.3f} µm, {1e3 * added:5.2f} ms longer, off the path by {1e3 * deviation(run.plan):.4f} mm"
    )
