"""Imperfections of signals and payload, for `flexfmu.run(scene, imperfections=[...])`: the tables ``[[imperfection]]`` of a scene file.

Objects of yours in series with signals are taken, too: blocks, slaves, python-control systems, paths of FMUs.
"""

from flexfmu.model.scene import imperfections
from flexfmu.parts import family

__all__, __getattr__, __dir__ = family(
    __name__,
    {
        "encoder(counts_per_turn=2**17)": imperfections.EncoderSection,
        'delay(time=5e-4, signal="position", known=True)': imperfections.DelaySection,
        "quantisation(resolution=1e-5)": imperfections.QuantisationSection,
        'noise(standard_deviation=1e-5, signal="position", seed=1)': imperfections.NoiseSection,
        "jitter(time=1e-4)": imperfections.JitterSection,
        "lag(time_constant=5e-4)": imperfections.LagSection,
        "saturation(limit=80.0)": imperfections.SaturationSection,
        "rate_limit(rate=5e3)": imperfections.RateLimitSection,
        "dead_zone(half_width=0.1)": imperfections.DeadZoneSection,
        "backlash(gap=1e-4)": imperfections.BacklashSection,
        "payload_error(relative=0.2)": imperfections.PayloadErrorSection,
        'parameter_error(parameters={"payload.mass": 7.0})': imperfections.ParameterErrorSection,
    },
    {},
)
