"""An own motion: a class with its duration and its positions, which the robot makes instead of the scene's path.

python own_trajectory.py
"""

from math import pi, sin

import numpy as np

import flexfmu


class Arch:
    """From x = -0.1 m to 0.1 m along an arch of 30 mm, with the acceleration of one period of a sine."""

    duration = 0.4  # [s]

    def position(self, time: float) -> tuple[float, float]:
        """x and y of the end effector [m]."""
        share = time / self.duration - sin(2.0 * pi * time / self.duration) / (2.0 * pi)
        return -0.1 + 0.2 * share, 0.32 - 0.03 * sin(pi * share) ** 2


run = flexfmu.run("barnard2012-6kg", trajectory=Arch())
print(
    f"peak torque {run.metrics.peak_torque_1:.3f} N.m, residual vibration {1e6 * run.metrics.residual_vibration_amplitude:.2f} µm"
)

# without a robot: derivatives of any order, for all instants at once, (order + 1, instants, 2)
position, velocity, acceleration, jerk = flexfmu.motions.as_trajectory(Arch()).evaluate(
    np.linspace(0.0, 0.4, 1001), order=3
)
print(f"top speed {np.linalg.norm(velocity, axis=1).max():.4f} m/s")
