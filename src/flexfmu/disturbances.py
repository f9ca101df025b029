"""Forces, torques and masses that disturb the robot, for `flexfmu.run(scene, disturbances=[...])`: the tables ``[[disturbance]]`` of a scene file."""

from flexfmu.model.scene import disturbances
from flexfmu.parts import family

__all__, __getattr__, __dir__ = family(
    __name__,
    {
        'step(signal="joint1.disturbance", amplitude=5.0, start=0.1)': disturbances.StepSection,
        'pulse(signal="force.x", amplitude=100.0, start=0.1, duration=1e-3)': disturbances.PulseSection,
        'sine(signal="force.y", amplitude=10.0, frequency=40.0)': disturbances.SineSection,
        'noise(signal="force.x", standard_deviation=2.0, band=(5.0, 50.0))': disturbances.BandNoiseSection,
        'csv(signal="force.x", file="disturbance.csv")': disturbances.CsvSection,
        "payload(dropped=0.3)": disturbances.PayloadChangeSection,
    },
    {},
)
