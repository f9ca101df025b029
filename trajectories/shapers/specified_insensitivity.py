"""Specified-insensitivity shapers: the shortest sequence whose residual is tolerable over a frequency range.

The sequence is found by optimisation over frequency samples (Singhose, Seering and Singer, "Input Shaping for Vibration Reduction with
Specified Insensitivity to Modeling Errors", Japan-USA Symposium on Flexible Automation, 1996; Vaughan, Yano and Singhose,
"Comparison of Robust Input Shapers", J. Sound and Vibration 315, 2008).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexfmu.trajectories.errors import TrajectoryError, positive
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.shapers.extra_insensitive import chebyshev_amplitudes
from flexfmu.trajectories.shapers.sequence import ImpulseSequence, checked_fraction, checked_ratio

MOST_IMPULSES = 10
"""Largest number of impulses; enough for a range from half to twice a frequency at 5 %."""

SAMPLES_PER_IMPULSE = 40
"""Frequency samples per impulse during the optimisation; a hump of the residual spans about so many."""

DENSITY = 10
"""Factor by which the final check has more frequency samples than the optimisation."""

EXCESS = 1e-3
"""Accepted excess of the residual over the tolerance between the samples, relative to the tolerance."""

SMALLEST_GAP = 0.05
"""Smallest distance of two impulses, in periods of the middle frequency."""


def specified_insensitivity(
    lowest: float, highest: float, tolerance: float = 0.05, ratio: float = 0.0
) -> ImpulseSequence:
    """Design the shortest sequence of positive impulses whose residual is at most a tolerance over a frequency range.

    Args:
        lowest, highest: the range of the natural frequency [Hz].
        tolerance: admissible residual, 0 to 1 exclusive.
        ratio: damping ratio ζ, the same over the whole range.

    Raises:
        TrajectoryError: an argument is out of range, or ten impulses don't suffice.
    """
    positive("lowest frequency", lowest, "Hz")
    if not (math.isfinite(highest) and highest >= lowest):
        raise TrajectoryError(f"highest frequency must be at least the lowest, {lowest:g} Hz, got {highest:g} Hz")
    checked_fraction("tolerable residual", tolerance)
    checked_ratio(ratio)
    # add impulses until the residual is tolerable over the whole range, checked on more samples than in the optimisation
    middle = 0.5 * (lowest + highest)
    for impulses in range(2, MOST_IMPULSES + 1):
        problem = _Problem(impulses, lowest / middle, highest / middle, tolerance, ratio)
        amplitudes, periods = problem.solve()
        if problem.worst(amplitudes, periods) <= tolerance * (1.0 + EXCESS):
            return ImpulseSequence(tuple(periods / middle), tuple(amplitudes / np.sum(amplitudes)))
    raise TrajectoryError(
        f"no sequence of {MOST_IMPULSES} impulses keeps the residual at {tolerance:g} from {lowest:g} to {highest:g} Hz "
        f"with a damping ratio of {ratio:g}: choose a narrower range or a larger tolerance"
    )


@dataclass(frozen=True)
class _Problem:
    """Minimisation of the last impulse's time, in units of the middle frequency and its period."""

    impulses: int
    lowest: float
    highest: float
    tolerance: float
    ratio: float

    def solve(self) -> tuple[RealArray, RealArray]:
        """Return amplitudes and times, both (N,); with too few impulses the residual exceeds the tolerance."""

        from scipy.optimize import Bounds, minimize  # here, since most motions need no scipy

        def last_time(x: RealArray) -> float:
            return float(x[-1])

        # unknowns: all amplitudes, and all times but the first; goal, bounds, order and sum are linear in them
        n = self.impulses
        goal = np.zeros(2 * n - 1)
        goal[-1] = 1.0
        total = np.concatenate([np.ones(n), np.zeros(n - 1)])
        order = np.hstack([np.zeros((n - 1, n)), np.eye(n - 1) - np.eye(n - 1, k=-1)])
        arguments: dict[str, Any] = {
            "method": "SLSQP",
            "jac": lambda x: goal,
            "bounds": Bounds(np.zeros(2 * n - 1), np.r_[np.ones(n), np.full(n - 1, np.inf)]),
            "constraints": [
                {"type": "ineq", "fun": lambda x: self._margins(x)[0], "jac": lambda x: self._margins(x)[1]},
                {"type": "ineq", "fun": lambda x: order @ x - SMALLEST_GAP, "jac": lambda x: order},
                {"type": "eq", "fun": lambda x: x @ total - 1.0, "jac": lambda x: total},
            ],
            "options": {"maxiter": 500, "ftol": 1e-12},
        }
        # start from the Chebyshev sequence of this number of impulses, half a period apart
        times = 0.5 * np.arange(n)
        amplitudes = chebyshev_amplitudes(n, self.tolerance) * np.exp(-2.0 * np.pi * self.ratio * times)
        start = np.concatenate([amplitudes / np.sum(amplitudes), times[1:]])
        found = minimize(last_time, start, **arguments)
        return self._unpack(np.asarray(found.x))

    def worst(self, amplitudes: RealArray, times: RealArray) -> float:
        """Return the largest residual over the range."""
        frequencies = np.linspace(self.lowest, self.highest, DENSITY * SAMPLES_PER_IMPULSE * self.impulses)
        return float(np.sqrt(np.max(self._squares(amplitudes, times, frequencies)[0])))

    def _unpack(self, x: RealArray) -> tuple[RealArray, RealArray]:
        return x[: self.impulses], np.concatenate([[0.0], x[self.impulses :]])

    def _margins(self, x: RealArray) -> tuple[RealArray, RealArray]:
        """Return 1 - (residual / tolerance)² at M samples (M,), and its Jacobian by the unknowns (M, 2 N - 1)."""
        samples = np.linspace(self.lowest, self.highest, SAMPLES_PER_IMPULSE * self.impulses)
        squares, by_amplitudes, by_times = self._squares(*self._unpack(x), samples)
        slopes = -np.hstack([by_amplitudes, by_times[:, 1:]]) / self.tolerance**2
        return np.asarray(1.0 - squares / self.tolerance**2), np.asarray(slopes)

    def _squares(
        self, amplitudes: RealArray, times: RealArray, frequencies: RealArray
    ) -> tuple[RealArray, RealArray, RealArray]:
        """Return squared residuals (M,) after the latest impulse, and their Jacobians by amplitudes and times, (M, N) each."""
        # decay relative to the latest impulse, so that no exponent has a positive real part
        latest = int(np.argmax(times))  # iterates may have impulses out of order
        omega = 2.0 * np.pi * frequencies
        pole = complex(self.ratio, math.sqrt(1.0 - self.ratio**2))
        waves = np.exp(np.outer(omega, pole * times - self.ratio * times[latest]))
        # |Σ A_i w_i|² and its derivatives; all w_i depend on the latest time
        response = waves @ amplitudes
        squares = np.abs(response) ** 2
        by_amplitudes = 2.0 * (np.conj(response)[:, None] * waves).real
        by_times = 2.0 * (np.conj(response)[:, None] * waves * (pole * omega)[:, None] * amplitudes).real
        by_times[:, latest] -= 2.0 * self.ratio * omega * squares
        return squares, by_amplitudes, by_times
