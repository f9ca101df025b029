"""Simulate a scene from Python: change some of its values, run it, read metrics and signals, write the files.

python run_scene.py
"""

import flexfmu

# a shipped scene (or the path of your own file), with a gentler profile and less payload
scene = flexfmu.load_scene("barnard2012-6kg").replace(
    {"name": "gentle", "payload.mass": 3.0, "trajectory.profile": {"kind": "trapezoidal", "ramp": 0.25}}
)

# plans the motion, builds the FMU or takes it from the cache, co-simulates motion and dwell
run = flexfmu.run(scene)
print(f"{run.outcome.value} in {run.timing.simulate:.2f} s, {run.health.statistics['steps']} integrator steps")

for name, measurement in flexfmu.measure_run(run).items():
    print(f"{name:30} {flexfmu.display(name, measurement.value)}")

# every signal has values and a unit; an instant at which something jumps appears twice, before and after
acceleration, at_start = run.recording["der(link11.bending[1],2)"], run.recording.time == 0.0
before, after = acceleration.values[at_start]
print(f"when the motors start, the first bending mode accelerates from {before:.3g} to {after:.3g} {acceleration.unit}")

print(f"wrote {run.recording.write_csv('results.csv')}")
