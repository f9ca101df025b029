"""Input shapers: impulse sequences that suppress residual vibration, and motions convolved with them."""

from flexfmu.trajectories.shapers.catalogue import SHAPERS, design
from flexfmu.trajectories.shapers.extra_insensitive import extra_insensitive
from flexfmu.trajectories.shapers.sequence import UNSHAPED, ImpulseSequence, Oscillator
from flexfmu.trajectories.shapers.shaped_joints import (
    EndEffectorTrajectory,
    ShapedTrajectory,
    path_deviation,
)
from flexfmu.trajectories.shapers.shaped_profile import shape_along_path
from flexfmu.trajectories.shapers.specified_insensitivity import specified_insensitivity
from flexfmu.trajectories.shapers.zero_vibration import modified_zero_vibration, unity_magnitude, zero_vibration

__all__ = [
    "SHAPERS",
    "UNSHAPED",
    "EndEffectorTrajectory",
    "ImpulseSequence",
    "Oscillator",
    "ShapedTrajectory",
    "design",
    "extra_insensitive",
    "modified_zero_vibration",
    "path_deviation",
    "shape_along_path",
    "specified_insensitivity",
    "unity_magnitude",
    "zero_vibration",
]
