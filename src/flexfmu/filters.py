"""Filters of torques, measurements and references, for `flexfmu.run(scene, filters=[...])`: the tables ``[[filter]]`` of a scene file."""

from flexfmu.model.scene import filters
from flexfmu.parts import family

__all__, __getattr__, __dir__ = family(
    __name__,
    {
        'notch(at="resonance 1", damping=0.3, depth=0.1)': filters.NotchSection,
        'low_pass(frequency=200.0, order=2, signal="velocity")': filters.LowPassSection,
        'high_pass(frequency=1.0, signal="velocity")': filters.HighPassSection,
        "lead_lag(zero=20.0, pole=80.0)": filters.LeadLagSection,
        "biquad(numerator=[1.0], denominator=[1e-3, 1.0])": filters.BiquadSection,
    },
    {},
)
