"""Which shaper to take: the one after which the robot is at rest soonest, whatever the payload in its band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flexfmu.cosim.shaping.study import UNSHAPED_NAME, Result

RESOLUTION = 1e-4
"""Times to rest [s] that differ by less count as equal; then the smaller path deviation decides."""


@dataclass(frozen=True)
class Limits:
    """What a recommended motion must not exceed; None for no limit.

    Attributes:
        deviation: from the path [m].
        added_time: [s].
        jerk: of either joint's reference [rad/s3].
        torque: of either motor, over the payload band [N.m].
    """

    deviation: float | None = None
    added_time: float | None = None
    jerk: float | None = None
    torque: float | None = None

    def exceeded(self, result: Result) -> list[str]:
        """A phrase for each limit that a result exceeds."""
        return [
            f"{what} {scale * value:.4g} {unit} above {scale * limit:.4g} {unit}"
            for what, value, limit, scale, unit in self._compared(result)
            if value > limit * (1.0 + ROUNDING)
        ]

    def _compared(self, result: Result) -> list[tuple[str, float, float, float, str]]:
        """Quantity, value, limit, factor to the unit shown and that unit, for each limit there is."""
        rows = (
            ("path deviation", result.path_deviation, self.deviation, 1e3, "mm"),
            ("added time", result.added_time, self.added_time, 1e3, "ms"),
            ("joint jerk", result.peak_jerk, self.jerk, 1.0, "rad/s³"),
            ("peak torque", result.peak_torque, self.torque, 1.0, "N·m"),
        )
        return [(what, value, limit, scale, unit) for what, value, limit, scale, unit in rows if limit is not None]


ROUNDING = 1e-9
"""Limits are kept to within this share of themselves."""


@dataclass(frozen=True)
class Recommendation:
    """The choice among the results.

    Attributes:
        result: the recommended one; the unshaped motion where no shaper is of use, or nothing keeps the limits.
        reason: why, in one sentence.
        keeps_limits: whether the result keeps all limits; if it doesn't, nothing that was tried does.
    """

    result: Result
    reason: str
    keeps_limits: bool = True


def recommend(results: Sequence[Result], settling_band: float, limits: Limits | None = None) -> Recommendation:
    """The result with the shortest time to rest over the payload band; of equal ones that with the smallest deviation.

    Where none comes to rest within the dwell for all payloads, the one with the smallest worst residual vibration. Only
    what keeps the limits counts.

    Args:
        results: the unshaped motion and the shaped ones.
        settling_band: radius around the equilibrium that counts as rest [m].
        limits: what the motion must not exceed; None for no limits.
    """
    unshaped = next(result for result in results if result.candidate.name == UNSHAPED_NAME)
    limits = limits or Limits()
    allowed = [result for result in results if not limits.exceeded(result)]
    if not allowed:
        nearest = min(results, key=lambda result: len(limits.exceeded(result)))
        return Recommendation(
            unshaped,
            f"nothing keeps the limits; nearest is {nearest.candidate.label}: {', '.join(limits.exceeded(nearest))}",
            keeps_limits=False,
        )
    results = allowed
    settled = [(result.time_to_rest, result) for result in results if result.time_to_rest is not None]
    if not settled:
        best = min(results, key=lambda result: result.worst_residual)
        return Recommendation(best, _smallest_residual(best, unshaped, settling_band))
    shortest = min(time for time, _ in settled)
    best = min((r for time, r in settled if time <= shortest + RESOLUTION), key=lambda result: result.path_deviation)
    if best is unshaped:
        return Recommendation(
            best,
            f"no shaper brings the robot to rest sooner; the unshaped motion: {_rest(best, settling_band)}{_payloads(best)}",
        )
    return Recommendation(
        best,
        f"{_rest(best, settling_band)}{_payloads(best)}, with a path deviation of {1e3 * best.path_deviation:.3g} mm; "
        f"the unshaped motion: {_rest(unshaped, settling_band)}",
    )


def compare_slower(result: Result, slower: Result, settling_band: float) -> str:
    """What the added time would bring without a shaper, as a sentence."""
    return f"An unshaped motion slower by the same {1e3 * result.added_time:.1f} ms: {_rest(slower, settling_band)}"


def _rest(result: Result, band: float) -> str:
    """When a motion comes to rest, for all payloads."""
    if result.time_to_rest is None:
        return f"{1e6 * result.worst_residual:.3g} µm, no rest within {1e6 * band:g} µm during the dwell"
    return f"rest within {1e6 * band:g} µm {1e3 * result.time_to_rest:.1f} ms after the end of the scene's own motion"


def _smallest_residual(best: Result, unshaped: Result, band: float) -> str:
    return (
        f"nothing comes to rest within {1e6 * band:g} µm during the dwell{_payloads(best)}; this leaves the smallest "
        f"residual vibration, {1e6 * best.worst_residual:.3g} µm at worst instead of {1e6 * unshaped.worst_residual:.3g} µm"
    )


def _payloads(result: Result) -> str:
    errors = [trial.payload_error for trial in result.trials]
    return f" for payloads from {100.0 * min(errors):+.0f} % to {100.0 * max(errors):+.0f} %" if len(errors) > 1 else ""
