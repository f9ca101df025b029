"""Forces, torques and masses that disturb the robot, for `flexfmu.run(scene, disturbances=[...])`: the tables ``[[disturbance]]`` of a scene file."""

from flexfmu.model.scene import disturbances
from flexfmu.parts import part

__all__ = [
    "csv",
    "noise",
    "payload",
    "pulse",
    "sine",
    "step",
]

step = part(disturbances.StepSection, 'disturbances.step(signal="joint1.disturbance", amplitude=5.0, start=0.1)')
pulse = part(
    disturbances.PulseSection, 'disturbances.pulse(signal="force.x", amplitude=100.0, start=0.1, duration=1e-3)'
)
sine = part(disturbances.SineSection, 'disturbances.sine(signal="force.y", amplitude=10.0, frequency=40.0)')
noise = part(
    disturbances.BandNoiseSection, 'disturbances.noise(signal="force.x", standard_deviation=2.0, band=(5.0, 50.0))'
)
csv = part(disturbances.CsvSection, 'disturbances.csv(signal="force.x", file="disturbance.csv")')
payload = part(disturbances.PayloadChangeSection, "disturbances.payload(dropped=0.3)")
