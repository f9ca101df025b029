"""The paper's mechanism, path and profiles, for the tests of this folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

from flexfmu.trajectories.jets import Jet, RealArray, arctan2, sqrt
from flexfmu.trajectories.joint import Margin
from flexfmu.trajectories.trajectory import Trajectory


@dataclass(frozen=True)
class FiveBar:
    """Inverse kinematics of the paper's five-bar, elbows outwards; independent of `flexfmu.model`."""

    half_base: float = 0.1
    proximal: float = 0.24
    distal: float = 0.38079
    required: float = 1e-3

    def joints(self, x: Jet, y: Jet) -> tuple[Jet, Jet]:
        """q1 = angle(X - B1) + acos(..), q2 = angle(X - B2) - acos(..)."""
        return self._joint(x + self.half_base, y, 1.0), self._joint(x - self.half_base, y, -1.0)

    def margins(self, position: RealArray) -> tuple[Margin, ...]:
        """Reach of both legs."""
        reach = self.proximal + self.distal
        distances = [np.hypot(position[:, 0] - base, position[:, 1]) for base in (-self.half_base, self.half_base)]
        return tuple(
            Margin(f"reach of leg {i}", "m", reach - distance, self.required)
            for i, distance in enumerate(distances, start=1)
        )

    def end_effector(self, q1: RealArray, q2: RealArray) -> RealArray:
        """Forward kinematics, end effector on the left of the line from elbow 1 to elbow 2; shape (N, 2) [m]."""
        first = np.stack([-self.half_base + self.proximal * np.cos(q1), self.proximal * np.sin(q1)], axis=-1)
        second = np.stack([self.half_base + self.proximal * np.cos(q2), self.proximal * np.sin(q2)], axis=-1)
        line = second - first
        half = 0.5 * np.linalg.norm(line, axis=-1, keepdims=True)
        left = np.stack([-line[:, 1], line[:, 0]], axis=-1) / (2.0 * half)
        return np.asarray(first + 0.5 * line + np.sqrt(self.distal**2 - half**2) * left)

    def _joint(self, dx: Jet, dy: Jet, sign: float) -> Jet:
        square = dx * dx + dy * dy
        cosine = (square + (self.proximal**2 - self.distal**2)) / (2.0 * self.proximal * sqrt(square))
        return arctan2(dy, dx) + sign * arctan2(sqrt(1.0 - cosine * cosine), cosine)


def assert_integrals(trajectory: Trajectory, rounding: float) -> None:
    """Every derivative to order 8 changes between the limits at an interval's ends by the integral of the next one."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    for start, end in pairwise(trajectory.breakpoints):
        edges = np.linspace(start, end, 17)
        half = 0.5 * np.diff(edges)
        values = trajectory.evaluate((edges[:-1] + half * (nodes[:, None] + 1.0)).ravel(), 8)
        integrals = np.einsum("n,i,knic->kc", weights, half, values.reshape(9, 40, 16, 2))
        first, last = (trajectory.evaluate(t, 8, s)[:, 0] for t, s in ((start, "right"), (end, "left")))
        scale = np.abs(values).max(axis=(1, 2))[:, None] * (end - start)
        assert np.all(np.abs(last[:-1] - first[:-1] - integrals[1:]) <= 1e-11 * scale[1:] + rounding)


@pytest.fixture
def exact_derivatives() -> Callable[[Trajectory, float], None]:
    """See `assert_integrals`."""
    return assert_integrals


@pytest.fixture
def five_bar() -> FiveBar:
    """The paper's mechanism."""
    return FiveBar()
