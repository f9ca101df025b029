"""Impulse sequences against closed forms: residual vibration, insensitivity, durations, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.shapers import designs
from flexfmu.trajectories.shapers.sequence import UNSHAPED, ImpulseSequence, Oscillator

FREQUENCY = 58.0
ratios = st.floats(0.0, 0.2)
frequencies = st.floats(0.5, 500.0)
shapers = st.sampled_from(sorted(designs.SHAPERS))
settle = settings(max_examples=60)


def vibration(sequence: ImpulseSequence, mode: Oscillator, time: float) -> complex:
    """Deflection and velocity/ω of an oscillator at a time after the last impulse, from the sum of its impulse responses."""
    omega, ratio = mode.angular_frequency, mode.ratio
    damped = omega * np.sqrt(1.0 - ratio**2)
    x = v = 0.0
    for delay, amplitude in zip(sequence.times, sequence.amplitudes, strict=True):
        tau = time - delay
        envelope = amplitude * np.exp(-ratio * omega * tau)
        x += envelope * omega / damped * np.sin(damped * tau)
        v += envelope * (np.cos(damped * tau) - ratio * omega / damped * np.sin(damped * tau))
    return complex(x, v)


def insensitive(sequence: ImpulseSequence, frequency: float, level: float = 0.05, ratio: float = 0.0) -> float:
    """Width of the range with at most this residual, by the frequency; up to three times it where damping leaves no upper end."""
    grid = frequency * np.linspace(0.0, 4.0, 40001)
    over = grid[sequence.residual(grid, ratio) > level * (1.0 + 1e-6)]
    low, high = over[over < frequency].max(initial=0.0), over[over > frequency].min(initial=4.0 * frequency)
    return float(high - low - grid[1]) / frequency


@pytest.mark.parametrize(
    ("name", "periods", "insensitivity", "percent"),
    [
        ("um-zv", 1 / 3, 0.055, ()),
        ("zv", 0.5, 0.0637, (15.6, 30.9, 45.4)),
        ("mzv", 0.75, None, ()),
        ("zvd", 1.0, 0.287, (2.45, 9.55, 20.6)),
        ("ei", 1.0, 0.399, (2.43, 5.03, 16.64)),
        ("zvdd", 1.5, 0.480, (0.38, 2.95, 9.4)),
        ("2-hump-ei", 1.5, 0.7245, ()),
        ("zvddd", 2.0, None, ()),
        ("3-hump-ei", 2.0, None, ()),
    ],
)
def test_published_figures(name: str, periods: float, insensitivity: float | None, percent: tuple[float, ...]) -> None:
    """Duration, width of the range with at most 5 % residual, and residual at errors of 10, 20 and 30 %, without damping."""
    sequence = designs.design(name, [Oscillator(FREQUENCY)])
    assert sequence.duration * FREQUENCY == pytest.approx(periods, abs=1e-12)
    if insensitivity is not None:
        assert insensitive(sequence, FREQUENCY) == pytest.approx(insensitivity, abs=5e-4)
    for error, expected in zip((0.1, 0.2, 0.3), percent, strict=False):
        residual = sequence.residual([FREQUENCY * (1.0 - error), FREQUENCY * (1.0 + error)])
        np.testing.assert_allclose(100.0 * residual, expected, atol=0.05)


def test_multi_hump_amplitudes_are_the_published_ones() -> None:
    """The Chebyshev sequences are the closed forms of Singhose, Porter, Tuttle and Singer (1997)."""
    v = 0.05
    x = np.cbrt(v**2 * (np.sqrt(1.0 - v**2) + 1.0))
    two = (3.0 * x**2 + 2.0 * x + 3.0 * v**2) / (16.0 * x)
    np.testing.assert_allclose(designs.chebyshev_amplitudes(4, v), [two, 0.5 - two, 0.5 - two, two], rtol=1e-12)
    first, second = (1.0 + 3.0 * v + 2.0 * np.sqrt(2.0 * v**2 + 2.0 * v)) / 16.0, 0.25 * (1.0 - v)
    middle = 1.0 - 2.0 * (first + second)
    np.testing.assert_allclose(designs.chebyshev_amplitudes(5, v), [first, second, middle, second, first], rtol=1e-12)


@pytest.mark.parametrize("ratio", [0.02, 0.1, 0.2])
def test_damped_sequences_are_the_published_fits(ratio: float) -> None:
    """The published polynomials in ζ of two humps for 5 %, and of UM-ZV, approximate the solution of the same equations."""
    powers, mode = ratio ** np.arange(4), Oscillator(1.0, ratio)
    two_humps, magnitude = designs.extra_insensitive(mode, 0.05, humps=2), designs.unity_magnitude(mode)
    for found, tolerance, *polynomials in (
        (two_humps.amplitudes[:2], 2e-3, [0.16054, 0.76699, 2.26560, -1.22750], [0.33911, 0.45081, -2.58080, 1.73650]),
        (two_humps.times[1:3], 4e-3, [0.49890, 0.16270, -0.54262, 6.16180], [0.99748, 0.18382, -1.58270, 8.17120]),
        (magnitude.times[1:], 2e-3, [0.16724, 0.27242, 0.20345, 0.0], [0.33323, 0.00533, 0.17914, 0.20125]),
    ):
        np.testing.assert_allclose(found, np.array(polynomials) @ powers, atol=tolerance)


@pytest.mark.parametrize("name", ["um-zv", "zv", "mzv", "zvd", "zvdd", "zvddd"])
@pytest.mark.parametrize("ratio", [0.0, 0.03, 0.1357, 0.4])
def test_a_damped_oscillator_stands_still(name: str, ratio: float) -> None:
    """Superposed impulse responses of a damped oscillator vanish after the last impulse of a shaper made for it."""
    mode = Oscillator(FREQUENCY, ratio)
    sequence = designs.design(name, [mode])
    for later in (1e-9, 0.3, 2.2):
        assert abs(vibration(sequence, mode, sequence.duration + later * mode.damped_period)) < 1e-12


@settle
@given(shapers, frequencies, ratios, st.floats(0.6, 1.5))
def test_residual_is_that_of_superposed_impulse_responses(name: str, f: float, ratio: float, factor: float) -> None:
    """The residual formula is the envelope of the simulated vibration: x and (x' + ζωx)/ω_d are its components."""
    sequence, mode = designs.design(name, [Oscillator(f, ratio)]), Oscillator(factor * f, ratio)
    state = vibration(sequence, mode, sequence.duration)
    damped = np.sqrt(1.0 - ratio**2)
    envelope = np.hypot(state.real, (state.imag + ratio * state.real) / damped) * damped
    assert sequence.residual(mode.frequency, ratio)[0] == pytest.approx(envelope, abs=1e-12)


@pytest.mark.parametrize("humps", [1, 2, 3])
@pytest.mark.parametrize("ratio", [0.0, 0.03, 0.1357, 0.2])
@pytest.mark.parametrize("tolerance", [0.02, 0.05, 0.1])
def test_humps_reach_the_tolerance(humps: int, ratio: float, tolerance: float) -> None:
    """Over its insensitive range an EI shaper has so many humps, all as high as tolerated, and zeros beside them."""
    mode = Oscillator(1.0, ratio)
    sequence = designs.extra_insensitive(mode, tolerance, humps)
    width = insensitive(sequence, 1.0, tolerance, ratio)
    low = next(f for f in np.linspace(1.0, 0.2, 4001) if sequence.residual(f, ratio)[0] > tolerance * (1.0 + 2e-6))
    curve = sequence.residual(np.linspace(low, low + width, 20001), ratio)
    inner = curve[1:-1]
    tops = inner[(inner > curve[:-2]) & (inner >= curve[2:])]
    assert np.count_nonzero(abs(tops - tolerance) < 1e-6 * tolerance) == humps
    assert np.count_nonzero((inner < curve[:-2]) & (inner <= curve[2:]) & (inner < 1e-3)) == humps + 1


@settle
@given(shapers, shapers, frequencies, st.floats(1.05, 6.0), ratios)
def test_convolution_multiplies_residuals(first: str, second: str, f: float, factor: float, ratio: float) -> None:
    """The residual of convolved sequences is the product: two modes are both cancelled."""
    low, high = designs.design(first, [Oscillator(f, ratio)]), designs.design(second, [Oscillator(factor * f, ratio)])
    both = low.convolve(high)
    probe = f * np.array([0.3, 1.0, 1.4, factor])
    np.testing.assert_allclose(
        both.residual(probe, ratio), low.residual(probe, ratio) * high.residual(probe, ratio), atol=1e-12
    )
    assert both.duration == pytest.approx(low.duration + high.duration, rel=1e-12)


def test_coinciding_impulses_are_one() -> None:
    """ZV with itself is ZVD; what isn't shaped stays as it is."""
    twice, zvd = designs.design("zv", [Oscillator(40.0, 0.05)] * 2), designs.design("zvd", [Oscillator(40.0, 0.05)])
    np.testing.assert_allclose(twice.times, zvd.times, atol=1e-15)
    np.testing.assert_allclose(twice.amplitudes, zvd.amplitudes, atol=1e-15)
    assert zvd.convolve(UNSHAPED) == zvd


@pytest.mark.parametrize(("name", "split"), [("zv", 0.0078), ("zvd", 0.0048)])
def test_split_impulses_keep_the_residual_small(name: str, split: float) -> None:
    """On a grid of 1 ms at 58 Hz impulses split over two samples leave under 1 %; rounded ones leave several times that."""
    sequence = designs.design(name, [Oscillator(58.0)])
    on_grid = sequence.split(1e-3)
    assert on_grid.residual(58.0)[0] == pytest.approx(split, abs=5e-5)
    assert on_grid.residual(58.0)[0] < 0.01
    np.testing.assert_allclose(np.array(on_grid.times) / 1e-3, np.round(np.array(on_grid.times) / 1e-3), atol=1e-9)
    moved = ImpulseSequence(tuple(1e-3 * np.round(np.array(sequence.times) / 1e-3)), sequence.amplitudes)
    assert moved.residual(58.0)[0] > 4.0 * on_grid.residual(58.0)[0]
    # a multiple of the sample time stays whole, rounding of the quotient notwithstanding
    assert len(designs.zero_vibration(Oscillator(1.0 / 0.6)).split(0.1).times) == 2


def test_specified_insensitivity_is_ei_at_its_own_width() -> None:
    """EI is the shortest sequence for the range that it covers (Vaughan, Yano and Singhose, 2008)."""
    mode = Oscillator(FREQUENCY)
    ei = designs.extra_insensitive(mode)
    half = 0.5 * insensitive(ei, FREQUENCY) * FREQUENCY
    found = designs.specified_insensitivity(FREQUENCY - half, FREQUENCY + half)
    np.testing.assert_allclose(found.times, ei.times, rtol=1e-3)
    np.testing.assert_allclose(found.amplitudes, ei.amplitudes, atol=1e-3)


@pytest.mark.slow
@settle
@given(st.floats(0.3, 0.999), shapers)
def test_high_damping_gives_a_sequence_or_a_reason(ratio: float, name: str) -> None:
    """Where a damped sequence doesn't exist the message says what to use instead; never is there a wrong sequence."""
    sequence, reason = None, ""
    try:
        sequence = designs.design(name, [Oscillator(2.0, ratio)])
    except TrajectoryError as error:
        reason = str(error)
    assert ": use " in reason if sequence is None else sequence.residual(2.0, ratio)[0] < 0.05 * (1.0 + 1e-6)
