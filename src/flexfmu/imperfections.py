"""Imperfections of signals and payload, for `flexfmu.run(scene, imperfections=[...])`: the tables ``[[imperfection]]`` of a scene file.

Objects of yours in series with signals are taken, too: blocks, slaves, python-control systems, paths of FMUs.
"""

from flexfmu.model.scene import imperfections
from flexfmu.parts import part

__all__ = [
    "backlash",
    "dead_zone",
    "delay",
    "encoder",
    "jitter",
    "lag",
    "noise",
    "payload_error",
    "quantisation",
    "rate_limit",
    "saturation",
]

encoder = part(imperfections.EncoderSection, "imperfections.encoder(counts_per_turn=2**17)")
delay = part(imperfections.DelaySection, 'imperfections.delay(time=5e-4, signal="position", known=True)')
quantisation = part(imperfections.QuantisationSection, "imperfections.quantisation(resolution=1e-5)")
noise = part(imperfections.NoiseSection, 'imperfections.noise(standard_deviation=1e-5, signal="position", seed=1)')
jitter = part(imperfections.JitterSection, "imperfections.jitter(time=1e-4)")
lag = part(imperfections.LagSection, "imperfections.lag(time_constant=5e-4)")
saturation = part(imperfections.SaturationSection, "imperfections.saturation(limit=80.0)")
rate_limit = part(imperfections.RateLimitSection, "imperfections.rate_limit(rate=5e3)")
dead_zone = part(imperfections.DeadZoneSection, "imperfections.dead_zone(half_width=0.1)")
backlash = part(imperfections.BacklashSection, "imperfections.backlash(gap=1e-4)")
payload_error = part(imperfections.PayloadErrorSection, "imperfections.payload_error(relative=0.2)")
