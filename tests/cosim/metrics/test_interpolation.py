"""The Hermite interpolant between communication points: order, extrema, quadrature, jumps and its error estimate."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.metrics.segments import (
    Analysis,
    HermiteSegments,
    bernstein_basis,
    contributions,
    cut,
    largest_magnitude,
)


def sine_segments(
    step: float, frequency: float, derivatives: int = 3, end: float = 1.0, phase: float = 0.3
) -> HermiteSegments:
    """sin(frequency t + phase) on [0, end] in equal segments, with its derivatives."""
    time = np.linspace(0.0, end, round(end / step) + 1)
    orders = np.arange(derivatives)[:, np.newaxis]
    nodes = (frequency**orders * np.sin(frequency * time + phase + orders * np.pi / 2))[:, :, np.newaxis]
    return HermiteSegments(time[:-1], time[1:], nodes[:, :-1], nodes[:, 1:])


def largest_error(segments: HermiteSegments, frequency: float, phase: float = 0.3) -> RealArray:
    """(n,) largest difference from the sine in each segment, densely sampled."""
    theta = np.linspace(0.0, 1.0, 41)
    time = segments.start + theta[:, np.newaxis] * segments.duration
    return np.asarray(np.abs(segments.evaluate(theta)[:, :, 0] - np.sin(frequency * time + phase)).max(axis=0))


@pytest.mark.parametrize(("derivatives", "steps"), [(2, (40, 80)), (3, (10, 20)), (5, (2, 4))])
def test_order_is_twice_the_number_of_derivatives(derivatives: int, steps: tuple[int, int]) -> None:
    """Halving the step divides the error by 2^(2m): 6th order with value, velocity and acceleration."""
    errors = [largest_error(sine_segments(1.0 / n, 5.0, derivatives), 5.0).max() for n in steps]
    slope = np.log(errors[0] / errors[1]) / np.log(steps[1] / steps[0])
    assert slope == pytest.approx(2 * derivatives, abs=0.25)


@pytest.mark.parametrize("derivatives", [3, 5])
@pytest.mark.parametrize(
    ("resolution", "factor"), [(0.5, 2.0), (1.0, 2.0), (2.0, 2.0), (4.0, 10.0), (6.0, 2.0), (12.0, 4.0)]
)
def test_error_estimate_is_honest(derivatives: int, resolution: float, factor: float) -> None:
    """Right within a factor of two while a step is below 2 rad of the vibration, in its order of magnitude beyond. Where orders
    diverge and are left out, it is at least what the last one that is left in contributes, which says no more than the order."""
    segments = sine_segments(0.01, resolution / 0.01, derivatives)
    analysis, true = Analysis(segments), largest_error(segments.consistent, resolution / 0.01)
    errors, whole = analysis.errors, analysis.kept == derivatives
    assert 1 / factor < errors[whole].max() / true[whole].max() < factor
    assert 0.1 < errors.max() / true.max() < 10.0
    last = np.sqrt(contributions(*segments.consistent._two_point))[analysis.kept - 2, np.arange(whole.size)]
    assert np.all(errors[~whole] >= last[~whole] * (1.0 - 1e-12))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_deviation_estimate_corrects_the_mean_square(order: int) -> None:
    """The estimated deviation of the interpolant and its derivatives is as large as theirs, and brings the mean square nearer."""
    omega = 50.0
    segments = sine_segments(0.01, omega, derivatives=3)
    points, weights = np.polynomial.legendre.leggauss(12)
    theta, weights = 0.5 * (points + 1.0), 0.5 * weights / len(segments.start)
    time = segments.start + theta[:, np.newaxis] * segments.duration
    exact = omega**order * np.sin(omega * time + 0.3 + order * np.pi / 2)
    error = exact - segments.evaluate(theta, order)[:, :, 0]
    square, common, deviation = Analysis(segments).mean_products(order)
    assert deviation == pytest.approx((weights @ error**2).sum(), rel=0.15)
    missing = (weights @ exact**2).sum() - square
    assert abs(missing - 2.0 * common - deviation) < 0.1 * abs(missing)


def test_error_estimate_ignores_jumps_at_breakpoints() -> None:
    """A jump of the signal is physics, not an interpolation error."""
    smooth = sine_segments(0.01, 10.0)
    shifted = HermiteSegments(smooth.start, smooth.end, smooth.left.copy(), smooth.right.copy())
    shifted.left[:, 50:] *= -3.0
    shifted.right[:, 50:] *= -3.0
    assert Analysis(shifted).errors.max() < 4 * Analysis(smooth).errors.max()


def test_error_estimate_ignores_tiny_steps() -> None:
    """A sample instant next to a communication point makes a step so short that high derivatives are all rounding."""
    omega, orders = 10.0, np.arange(3)[:, np.newaxis]
    time = np.sort(np.append(np.linspace(0.0, 1.0, 101), 0.5 + 1e-6))
    nodes = (omega**orders * np.sin(omega * time + orders * np.pi / 2))[:, :, np.newaxis]
    nodes *= 1.0 + 1e-13 * np.random.default_rng(1).normal(size=nodes.shape)  # an integrator's own noise
    segments = HermiteSegments(time[:-1], time[1:], nodes[:, :-1], nodes[:, 1:])
    assert Analysis(segments).errors.max() < 4 * Analysis(sine_segments(0.01, omega)).errors.max()


def test_error_estimate_of_a_single_segment_is_pessimistic() -> None:
    """A piece of one segment has no neighbours to learn from: the estimate bounds the error from above."""
    alone = sine_segments(1.0, 2.0)
    assert Analysis(alone).errors[0] > largest_error(alone, 2.0)[0]


def test_bisection_keeps_the_polynomial() -> None:
    """Both halves of polynomials, put together, are these; the largest magnitude is that of dense samples. A NaN doesn't hide."""
    control = np.random.default_rng(1).normal(size=(6, 3))
    first, second = cut(control)
    np.testing.assert_allclose(first[-1], second[0])
    found, halves = largest_magnitude(control), (largest_magnitude(first), largest_magnitude(second))
    assert found == pytest.approx(max(halves), rel=1e-12)
    dense = bernstein_basis(np.linspace(0.0, 1.0, 20_001), 5) @ control
    assert found == pytest.approx(np.abs(dense).max(), rel=1e-7)
    assert np.isnan(largest_magnitude(np.where(np.arange(18).reshape(6, 3) == 7, np.nan, 0.0)))


def added(first: HermiteSegments, second: HermiteSegments) -> HermiteSegments:
    """The sum of two signals on the same segments."""
    return HermiteSegments(first.start, first.end, first.left + second.left, first.right + second.right)


def decay_segments(step: float, rate: float, size: float, derivatives: int = 3) -> HermiteSegments:
    """What a coordinate that decays at once, but for rounding, says of its derivatives: (-rate)^k size at every point."""
    time = np.linspace(0.0, 1.0, round(1.0 / step) + 1)
    signs = np.where(np.arange(time.size) % 3, 1.0, -0.7)
    nodes = ((-rate) ** np.arange(derivatives)[:, np.newaxis] * size * signs)[:, :, np.newaxis]
    return HermiteSegments(time[:-1], time[1:], nodes[:, :-1], nodes[:, 1:])


@pytest.mark.parametrize("derivatives", [3, 5])
def test_derivatives_of_another_time_scale_are_left_out(derivatives: int) -> None:
    """Rounding in a coordinate that decays within 1e-7 s doesn't spoil what is slow; the estimate covers what is left."""
    slow, noise = sine_segments(0.01, 5.0, derivatives), decay_segments(0.01, 1e7, 1e-9, derivatives)
    signal = added(slow, noise)
    assert largest_error(signal, 5.0).max() > 0.1
    kept = signal.consistent
    assert largest_error(kept, 5.0).max() < 1e-4
    assert np.all(largest_error(kept, 5.0) <= 2.0 * Analysis(signal).errors + 1e-8)


@pytest.mark.parametrize("derivatives", [3, 5])
def test_small_ringing_far_below_the_step_adds_little(derivatives: int) -> None:
    """A vibration with 80 rad a step and a thousandth of the signal's size shifts the interpolant by some of its amplitudes,
    not by hundreds or thousands of them; the estimate says so."""
    step, frequency, small = 0.01, 8000.0, 1e-3
    ringing = sine_segments(step, frequency, derivatives)
    scaled = HermiteSegments(ringing.start, ringing.end, small * ringing.left, small * ringing.right)
    signal = added(sine_segments(step, 20.0, derivatives), scaled)
    assert largest_error(signal, 20.0).max() > 100.0 * small
    error = largest_error(signal.consistent, 20.0).max()
    assert error < 20.0 * small
    assert Analysis(signal).errors.max() > 0.5 * error


@pytest.mark.parametrize("resolution", [0.1, 1.0, 4.0])
def test_resolved_signals_keep_all_their_derivatives(resolution: float) -> None:
    """What a step resolves is interpolated as before, to the last bit."""
    segments = sine_segments(0.01, resolution / 0.01, 5)
    assert np.array_equal(segments.consistent.left, segments.left)
    assert np.array_equal(segments.consistent.right, segments.right)
