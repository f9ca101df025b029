"""Input shapers, for `flexfmu.run(scene, shapers=[...])`: the tables ``[[shaper]]`` of a scene file.

Without ``modes`` they suppress the lowest ``mode_count`` modes of the robot at the end of its path. `Shaper` applies an impulse
sequence of yours; `zero_vibration` and the like design sequences for an `Oscillator`.
"""

from flexfmu.model.scene.shapers import ImpulseShaperSection, SpecifiedInsensitivitySection
from flexfmu.parts import part, seldom

__all__ = [
    "ImpulseSequence",
    "Oscillator",
    "Shaper",
    "ei",
    "extra_insensitive",
    "modified_zero_vibration",
    "mzv",
    "si",
    "specified_insensitivity",
    "three_hump_ei",
    "two_hump_ei",
    "um_zv",
    "unity_magnitude",
    "zero_vibration",
    "zv",
    "zvd",
    "zvdd",
    "zvddd",
]

_DESIGNS = (
    "extra_insensitive",
    "modified_zero_vibration",
    "specified_insensitivity",
    "unity_magnitude",
    "zero_vibration",
)
__getattr__ = seldom(
    __name__,
    {
        "Shaper": "flexfmu.cosim.control.shapers",
        **dict.fromkeys(("ImpulseSequence", "Oscillator"), "flexfmu.trajectories.shapers.sequence"),
        **dict.fromkeys(_DESIGNS, "flexfmu.trajectories.shapers.designs"),
    },
)

zv = part(ImpulseShaperSection, 'shapers.zv(modes=[{"frequency": 58.0, "ratio": 0.1}])', "zv")
zvd = part(ImpulseShaperSection, "shapers.zvd()", "zvd")
zvdd = part(ImpulseShaperSection, 'shapers.zvdd(apply="path")', "zvdd")
zvddd = part(ImpulseShaperSection, "shapers.zvddd(mode_count=2)", "zvddd")
mzv = part(ImpulseShaperSection, "shapers.mzv()", "mzv")
ei = part(ImpulseShaperSection, "shapers.ei()", "ei")
two_hump_ei = part(ImpulseShaperSection, "shapers.two_hump_ei()", "2-hump-ei")
three_hump_ei = part(ImpulseShaperSection, "shapers.three_hump_ei()", "3-hump-ei")
um_zv = part(ImpulseShaperSection, 'shapers.um_zv(apply="sampled", sample_time=1e-3)', "um-zv")
si = part(SpecifiedInsensitivitySection, "shapers.si(band=(50.0, 70.0), tolerance=0.05)")
