"""Input shapers, for `flexfmu.run(scene, shapers=[...])`: the tables ``[[shaper]]`` of a scene file.

Without ``modes`` they suppress the lowest ``mode_count`` modes of the robot at the end of its path. `Shaper` applies an impulse
sequence of yours; `zero_vibration` and the like design sequences for an `Oscillator`.
"""

from flexfmu.model.scene.shapers import ImpulseShaperSection, SpecifiedInsensitivitySection
from flexfmu.parts import family

__all__, __getattr__, __dir__ = family(
    __name__,
    {
        'zv(modes=[{"frequency": 58.0, "ratio": 0.1}])': ImpulseShaperSection,
        "zvd()": ImpulseShaperSection,
        'zvdd(apply="path")': ImpulseShaperSection,
        "zvddd(mode_count=2)": ImpulseShaperSection,
        "mzv()": ImpulseShaperSection,
        "ei()": ImpulseShaperSection,
        "two_hump_ei()": ImpulseShaperSection,
        "three_hump_ei()": ImpulseShaperSection,
        'um_zv(apply="sampled", sample_time=1e-3)': ImpulseShaperSection,
        "si(band=(50.0, 70.0), tolerance=0.05)": SpecifiedInsensitivitySection,
    },
    {
        "cosim.control.shapers": "Shaper",
        "trajectories.shapers.sequence": "ImpulseSequence Oscillator",
        "trajectories.shapers.designs": "extra_insensitive modified_zero_vibration specified_insensitivity unity_magnitude zero_vibration",
    },
)
