"""Profiles with a limited jerk, sines and given coefficients: formulas, continuity, limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.trajectories import (
    BangBang,
    Cycloidal,
    DoubleS,
    FifthDegreePolynomial,
    Harmonic,
    ModifiedSine,
    ModifiedTrapezoid,
    PolynomialProfile,
    Profile,
    SeventhDegreePolynomial,
    TrajectoryError,
    Trapezoidal,
    evaluate_profile,
)

POLY7 = (0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0)
NEAR_ENDS = np.concatenate([np.geomspace(1e-12, 0.5, 100), 1.0 - np.geomspace(2.0**-40, 0.5, 100)])
seeded = settings(derandomize=True, deadline=None, max_examples=40)


def test_harmonic_profile_is_its_formula() -> None:
    """σ is exact relative to its own size next to the start, and all derivatives are those of a cosine."""
    motion = evaluate_profile(Harmonic(), NEAR_ENDS, 6).derivatives()
    np.testing.assert_allclose(motion[0], np.sin(0.5 * math.pi * NEAR_ENDS) ** 2, rtol=1e-15)
    for order in range(1, 7):
        derivative = -0.5 * math.pi**order * np.cos(math.pi * NEAR_ENDS + 0.5 * math.pi * order)
        np.testing.assert_allclose(motion[order], derivative, rtol=0, atol=1e-15 * math.pi**order)


def test_cycloidal_profile_is_its_formula() -> None:
    """σ keeps its digits next to the start, where η - sin(2πη)/2π has none, and the acceleration is 2π sin 2πη."""
    motion = evaluate_profile(Cycloidal(), NEAR_ENDS, 6).derivatives()
    u = 2.0 * math.pi * NEAR_ENDS
    np.testing.assert_allclose(motion[0], NEAR_ENDS - np.sin(u) / (2.0 * math.pi), rtol=0, atol=2e-16)
    small = NEAR_ENDS < 1e-3
    series = u**3 / 6.0 * (1.0 - u**2 / 20.0 * (1.0 - u**2 / 42.0)) / (2.0 * math.pi)
    np.testing.assert_allclose(motion[0][small], series[small], rtol=2e-15)
    to_end = np.minimum(NEAR_ENDS, 1.0 - NEAR_ENDS)
    np.testing.assert_allclose(motion[1], 2.0 * np.sin(math.pi * to_end) ** 2, rtol=1e-14)
    for order in range(2, 7):
        derivative = -((2.0 * math.pi) ** (order - 1)) * np.sin(u + 0.5 * math.pi * order)
        np.testing.assert_allclose(motion[order], derivative, rtol=0, atol=3e-15 * (2.0 * math.pi) ** (order - 1))


@pytest.mark.parametrize(
    ("profile", "acceleration"),
    [
        (ModifiedSine(), [(0.125, 4.0 * math.pi, 0.0), (0.875, 4.0 * math.pi / 3.0, math.pi / 3.0), (1.0, 4.0 * math.pi, -2.0 * math.pi)]),
        (
            ModifiedTrapezoid(),
            [(0.125, 4.0 * math.pi, 0.0), (0.375, 0.0, math.pi / 2.0), (0.625, 4.0 * math.pi, -math.pi), (0.875, 0.0, -math.pi / 2.0),
             (1.0, 4.0 * math.pi, -2.0 * math.pi)],
        ),
    ],
)  # fmt: skip
def test_modified_profiles_have_their_accelerations(
    profile: Profile, acceleration: list[tuple[float, float, float]]
) -> None:
    """The acceleration is C_a sin(ωη + φ), as Norton gives it, with one pair of ω and φ up to each join."""
    begin, peak = 0.0, float(evaluate_profile(profile, 0.125, 2).derivatives()[2, 0])
    for end, frequency, phase in acceleration:
        eta = np.linspace(begin, end, 50)[1:-1]
        found = evaluate_profile(profile, eta, 2).derivatives()[2]
        np.testing.assert_allclose(found, peak * np.sin(frequency * eta + phase), rtol=0, atol=1e-13)
        begin = end


@pytest.mark.parametrize(
    ("profile", "continuous"),
    [(DoubleS(0.3, 0.1), 2), (DoubleS(0.5, 0.25), 2), (ModifiedSine(), 3), (ModifiedTrapezoid(), 3)],
)
def test_joins_are_continuous_up_to_the_stated_derivative(profile: Profile, continuous: int) -> None:
    """The jerk of a double S jumps at its joins, the fourth derivative of the modified profiles at theirs."""
    before, after = (
        evaluate_profile(profile, np.array(profile.jumps), 4, side).derivatives() for side in ("left", "right")
    )  # type: ignore[arg-type]
    np.testing.assert_allclose(before[: continuous + 1], after[: continuous + 1], rtol=0, atol=3e-13)
    assert abs(before - after)[continuous + 1].max() > 1.0


@pytest.mark.parametrize(
    "profile", [FifthDegreePolynomial(), Cycloidal(), ModifiedSine(), ModifiedTrapezoid(), DoubleS(0.4, 0.2)]
)
def test_smooth_profiles_begin_and_end_without_acceleration(profile: Profile) -> None:
    """Those whose acceleration does not jump at the ends."""
    assert abs(evaluate_profile(profile, [0.0, 1.0], 2).derivatives()[2]).max() < 1e-14


@seeded
@given(st.floats(0.02, 0.5), st.floats(0.05, 1.0))
def test_double_s_of_any_phases_has_its_limits(ramp: float, share: float) -> None:
    """Velocity, acceleration and jerk have the limits that follow from the two phases, and the motion covers the path."""
    phase = share * 0.5 * ramp
    profile = DoubleS(ramp, phase)
    eta = np.unique([*np.linspace(0.0, 1.0, 201), *profile.jumps])
    motion = evaluate_profile(profile, eta, 3).derivatives()
    velocity = 1.0 / (1.0 - ramp)
    acceleration = velocity / (ramp - phase)
    assert motion[1].max() == pytest.approx(velocity, rel=1e-12)
    assert abs(motion[2]).max() == pytest.approx(acceleration, rel=1e-12)
    assert abs(motion[3]).max() == pytest.approx(acceleration / phase, rel=1e-12)
    left, right = (
        evaluate_profile(profile, np.array(profile.jumps), 1, side).coefficients for side in ("left", "right")
    )  # type: ignore[arg-type]
    np.testing.assert_allclose(left, right, rtol=0, atol=1e-13 * velocity)


def test_double_s_of_short_phases_is_a_trapezoid() -> None:
    """The limit of a jerk without bound."""
    eta = np.linspace(0.0, 1.0, 101)
    found, wanted = (
        evaluate_profile(profile, eta, 1).coefficients for profile in (DoubleS(0.25, 1e-9), Trapezoidal(0.25))
    )
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-8)


def test_coefficients_of_known_polynomials_are_these_profiles() -> None:
    """A given polynomial of degree 7 is poly7, to the last bit."""
    eta = np.linspace(0.0, 1.0, 101)
    found, wanted = (
        evaluate_profile(each, eta, 8).coefficients for each in (PolynomialProfile(POLY7), SeventhDegreePolynomial())
    )
    np.testing.assert_array_equal(found, wanted)


def test_polynomials_need_no_symmetry() -> None:
    """σ = 6 η² - 8 η³ + 3 η⁴, faster at first: velocity 12 η (1 - η)²."""
    motion = evaluate_profile(PolynomialProfile((0, 0, 6, -8, 3)), NEAR_ENDS, 1).derivatives()
    np.testing.assert_allclose(motion[1], 12.0 * NEAR_ENDS * (1.0 - NEAR_ENDS) ** 2, rtol=1e-13)


def test_digits_that_are_missing_at_the_end_are_made_up() -> None:
    """Rounded coefficients end at 1 and at rest all the same, and are continuous in the middle."""
    profile = PolynomialProfile((0.0, 0.0, 3.0 + 2e-10, -2.0 - 1e-10))
    np.testing.assert_array_equal(evaluate_profile(profile, 1.0, 1).coefficients[:, 0], [1.0, 0.0])
    left, right = (evaluate_profile(profile, 0.5, 3, side).coefficients for side in ("left", "right"))  # type: ignore[arg-type]
    np.testing.assert_allclose(left, right, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("coefficients", "message"),
    [
        ((0, 0), "must begin at rest: its first two coefficients must be 0"),
        ((0, 1, 0), "must begin at rest: its first two coefficients must be 0"),
        ((0, 0, 3, -2.1), r"must end at 1: its coefficients must have the sum 1, got 0\.9"),
        ((0, 0, 1), r"must end at rest: the sum of k c_k must be 0, got 2"),
        ((0, 0, math.nan), "must have finite coefficients"),
        ((0, 0, 27, -86, 96, -36), r"stops or goes backwards at 0\.5 of the duration"),
        ((0, 0, -3, 10, -6), r"stops or goes backwards at 0 of the duration"),
        ((0, 0, 12, -20, 9), r"stops or goes backwards at 1 of the duration"),
    ],
)
def test_polynomials_that_are_no_motion_are_refused(coefficients: tuple[float, ...], message: str) -> None:
    """Ends and direction are checked, and the message says what is wrong."""
    with pytest.raises(TrajectoryError, match=message):
        PolynomialProfile(coefficients)


@pytest.mark.parametrize(
    ("ramp", "phase", "message"),
    [
        (0.6, 0.1, "ramp must be above 0 and at most 0.5"),
        (0.3, 0.0, "jerk_phase must be above 0 and at most 0.25"),
        (0.2, 0.11, "jerk_phase must be at most half of ramp = 0.2, which is 0.1 of the duration, got 0.11"),
    ],
)
def test_phases_that_do_not_fit_are_refused(ramp: float, phase: float, message: str) -> None:
    """A ramp has room for two phases of constant jerk."""
    with pytest.raises(TrajectoryError, match=message):
        DoubleS(ramp, phase)


def test_full_double_s_has_the_velocity_of_bang_bang() -> None:
    """Ramps that fill the duration reach twice the mean velocity."""
    peaks = [evaluate_profile(each, 0.5, 1).derivatives()[1, 0] for each in (DoubleS(0.5, 0.1), BangBang())]
    assert peaks[0] == pytest.approx(peaks[1], rel=1e-14)
