"""Filters of torques, measurements and references, for `flexfmu.run(scene, filters=[...])`: the tables ``[[filter]]`` of a scene file."""

from flexfmu.model.scene import filters
from flexfmu.parts import part

__all__ = [
    "biquad",
    "high_pass",
    "lead_lag",
    "low_pass",
    "notch",
]

notch = part(filters.NotchSection, 'filters.notch(at="resonance 1", damping=0.3, depth=0.1)')
low_pass = part(filters.LowPassSection, 'filters.low_pass(frequency=200.0, order=2, signal="velocity")')
high_pass = part(filters.HighPassSection, 'filters.high_pass(frequency=1.0, signal="velocity")')
lead_lag = part(filters.LeadLagSection, "filters.lead_lag(zero=20.0, pole=80.0)")
biquad = part(filters.BiquadSection, "filters.biquad(numerator=[1.0], denominator=[1e-3, 1.0])")
