"""Motion profiles against their closed forms."""

from __future__ import annotations

import inspect
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.trajectories import profiles
from flexfmu.trajectories.profiles import PROFILES as KINDS

PROFILES = (
    profiles.seventh_degree_polynomial(),
    profiles.fifth_degree_polynomial(),
    profiles.bang_bang(),
    profiles.trapezoidal(0.25),
    profiles.trapezoidal(0.125),
    profiles.trapezoidal(0.5),
    profiles.double_s(0.25, 0.0625),
    profiles.double_s(0.5, 0.25),
    profiles.harmonic(),
    profiles.cycloidal(),
    profiles.modified_sine(),
    profiles.modified_trapezoid(),
    profiles.polynomial((0.0, 0.0, 3.0, -2.0)),
)
NEAR_ENDS = np.concatenate([np.geomspace(1e-12, 0.5, 100), 1.0 - np.geomspace(2.0**-40, 0.5, 100)])
seeded = settings(max_examples=40)


@pytest.mark.parametrize("profile", PROFILES)
def test_every_profile_is_a_symmetric_motion_from_rest_to_rest(profile: profiles.Profile) -> None:
    """Protects ends, monotonicity and the point symmetry about the middle."""
    eta = np.linspace(0.0, 1.0, 401)
    motion = profiles.evaluate_profile(profile, eta, 3).derivatives()
    np.testing.assert_array_equal(motion[:2, [0, -1]], [[0.0, 1.0], [0.0, 0.0]])
    assert np.all(np.diff(motion[0]) > 0.0)
    single = [profiles.evaluate_profile(profile, one, 3).derivatives()[:, 0] for one in eta]
    np.testing.assert_array_equal(motion, np.transpose(single), "to the last bit, whatever else is evaluated")
    mirrored = profiles.evaluate_profile(profile, eta, 3, side="left").derivatives()[:, ::-1]
    np.testing.assert_allclose(motion[0], 1.0 - mirrored[0], rtol=0, atol=5e-16)
    for order, sign in ((1, 1.0), (2, -1.0), (3, 1.0)):
        np.testing.assert_allclose(motion[order], sign * mirrored[order], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "profile", [profiles.seventh_degree_polynomial(), profiles.polynomial((0, 0, 0, 0, 35, -84, 70, -20))]
)
def test_seventh_degree_polynomial_is_exact_to_its_last_derivative(profile: profiles.Profile) -> None:
    """Protects all derivatives, relative to their own size, also next to the ends: velocity is 140 η³ (1 - η)³."""
    eta = NEAR_ENDS
    motion = profiles.evaluate_profile(profile, eta, 8).derivatives()
    rest = 1.0 - eta
    np.testing.assert_allclose(motion[0], 35 * eta**4 - 84 * eta**5 + 70 * eta**6 - 20 * eta**7, rtol=2e-14)
    np.testing.assert_allclose(motion[1], 140 * eta**3 * rest**3, rtol=1e-14)
    np.testing.assert_allclose(motion[2], 420 * eta**2 * rest**2 * (1 - 2 * eta), rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(motion[3], 840 * eta * rest * (1 - 5 * eta * rest), rtol=1e-13, atol=1e-12)
    np.testing.assert_allclose(motion[7], -math.factorial(7) * 20.0)
    np.testing.assert_array_equal(motion[8], 0.0)


@pytest.mark.parametrize(
    ("profile", "peak_velocity", "peak_acceleration"),
    [
        (profiles.seventh_degree_polynomial(), 35.0 / 16.0, 84.0 * math.sqrt(5.0) / 25.0),
        (profiles.bang_bang(), 2.0, 4.0),
        (profiles.trapezoidal(0.25), 4.0 / 3.0, 16.0 / 3.0),
        (profiles.trapezoidal(0.125), 8.0 / 7.0, 64.0 / 7.0),
        (profiles.fifth_degree_polynomial(), 15.0 / 8.0, 10.0 / math.sqrt(3.0)),
        (profiles.harmonic(), math.pi / 2.0, math.pi**2 / 2.0),
        (profiles.cycloidal(), 2.0, 2.0 * math.pi),
        (profiles.modified_sine(), 4.0 * math.pi / (4.0 + math.pi), 4.0 * math.pi**2 / (4.0 + math.pi)),
        (profiles.modified_trapezoid(), 2.0, 8.0 * math.pi / (2.0 + math.pi)),
    ],
)
def test_peaks_have_their_closed_forms(
    profile: profiles.Profile, peak_velocity: float, peak_acceleration: float
) -> None:
    """Protects velocity and acceleration, which scale every torque."""
    # peaks of the polynomials' accelerations are at the last two
    eta = np.append(np.linspace(0.0, 1.0, 4001), [0.5 - 0.1 * math.sqrt(5.0), 0.5 - math.sqrt(3.0) / 6.0])
    motion = profiles.evaluate_profile(profile, eta, 2).derivatives()
    assert motion[1].max() == pytest.approx(peak_velocity, rel=1e-14)
    assert motion[2].max() == pytest.approx(peak_acceleration, rel=1e-13)


@seeded
@given(st.sampled_from(PROFILES), st.floats(1e-6, 1.0 - 1e-6))
def test_times_of_passage_are_exact(profile: profiles.Profile, fraction: float) -> None:
    """Protects the times at which knots of the path are passed."""
    eta = profiles.time_at(profile, fraction)
    assert profiles.evaluate_profile(profile, eta, 0).value[0] == pytest.approx(fraction, rel=2e-15, abs=0)


def test_table_names_the_parameters_of_each_profile() -> None:
    """Protects scene files: their keys are the parameters of the profile's function, and a key has one range for all profiles."""
    ranges: dict[str, profiles.Parameter] = {}
    for kind in KINDS.values():
        assert set(inspect.signature(kind.make).parameters) == set(kind.parameters)
        for name, parameter in kind.parameters.items():
            assert ranges.setdefault(name, parameter) == parameter


@seeded
@given(st.floats(0.02, 0.5), st.floats(0.05, 1.0))
def test_double_s_of_any_phases_has_its_limits(ramp: float, share: float) -> None:
    """Velocity, acceleration and jerk have the limits that follow from the two phases, and the motion covers the path."""
    phase = share * 0.5 * ramp
    profile = profiles.double_s(ramp, phase)
    eta = np.unique([*np.linspace(0.0, 1.0, 201), *profile.jumps])
    motion = profiles.evaluate_profile(profile, eta, 3).derivatives()
    velocity = 1.0 / (1.0 - ramp)
    acceleration = velocity / (ramp - phase)
    assert motion[1].max() == pytest.approx(velocity, rel=1e-12)
    assert abs(motion[2]).max() == pytest.approx(acceleration, rel=1e-12)
    assert abs(motion[3]).max() == pytest.approx(acceleration / phase, rel=1e-12)
    left, right = (
        profiles.evaluate_profile(profile, np.array(profile.jumps), 1, side).coefficients for side in ("left", "right")
    )  # type: ignore[arg-type]
    np.testing.assert_allclose(left, right, rtol=0, atol=1e-13 * velocity)


def test_polynomials_need_no_symmetry() -> None:
    """σ = 6 η² - 8 η³ + 3 η⁴, faster at first: velocity 12 η (1 - η)²."""
    motion = profiles.evaluate_profile(profiles.polynomial((0, 0, 6, -8, 3)), NEAR_ENDS, 1).derivatives()
    np.testing.assert_allclose(motion[1], 12.0 * NEAR_ENDS * (1.0 - NEAR_ENDS) ** 2, rtol=1e-13)


@pytest.mark.parametrize("profile", PROFILES)
def test_each_derivative_is_the_integral_of_the_next(profile: profiles.Profile) -> None:
    """Protects all pieces from position to the fifth derivative, by quadrature between joins, where velocity doesn't jump."""
    joins = [0.0, *profile.jumps, 1.0]
    nodes, weights = np.polynomial.legendre.leggauss(20)
    for start, end in pairwise(joins):
        inner = profiles.evaluate_profile(profile, start + 0.5 * (end - start) * (nodes + 1.0), 6).derivatives()
        first, last = (
            profiles.evaluate_profile(profile, x, 6, s).derivatives() for x, s in ((start, "right"), (end, "left"))
        )  # type: ignore[arg-type]
        scale = np.abs(inner).max(axis=1)[1:] * 1e-11 + 1e-13
        assert np.all(np.abs((last - first)[:-1, 0] - 0.5 * (end - start) * inner[1:] @ weights) <= scale)
        before = profiles.evaluate_profile(profile, start, 1, "left").derivatives()
        np.testing.assert_allclose(before, first[:2], rtol=0, atol=1e-13)


EIGHTHS = (0.125, 4.0 * math.pi, 0.0), (1.0, 4.0 * math.pi, -2.0 * math.pi)


@pytest.mark.parametrize(
    ("profile", "acceleration", "start"),
    [
        (profiles.harmonic(), [(1.0, math.pi, math.pi / 2.0)], (2, math.pi**2 / 4.0)),
        (profiles.cycloidal(), [(1.0, 2.0 * math.pi, 0.0)], (3, 2.0 * math.pi**2 / 3.0)),
        (profiles.modified_sine(), [EIGHTHS[0], (0.875, 4.0 * math.pi / 3.0, math.pi / 3.0), EIGHTHS[1]], None),
        (
            profiles.modified_trapezoid(),
            [
                *(EIGHTHS[0], (0.375, 0.0, math.pi / 2.0), (0.625, 4.0 * math.pi, -math.pi)),
                *((0.875, 0.0, -math.pi / 2.0), EIGHTHS[1]),
            ],
            None,
        ),
    ],
)
def test_sinusoidal_accelerations(
    profile: profiles.Profile, acceleration: list[tuple[float, float, float]], start: tuple[int, float] | None
) -> None:
    """The acceleration is C_a sin(ωη + φ), as Norton gives it, with one pair of ω and φ up to each join; σ keeps its digits next to
    the start, where it is a power of η."""
    begin, peak = 0.0, profiles.evaluate_profile(profile, np.linspace(0.0, 1.0, 4001), 2).derivatives()[2].max()
    for end, frequency, phase in acceleration:
        eta = np.linspace(begin, end, 50)[1:-1]
        found = profiles.evaluate_profile(profile, eta, 2).derivatives()[2]
        np.testing.assert_allclose(found, peak * np.sin(frequency * eta + phase), rtol=0, atol=1e-13)
        begin = end
    if start is not None:
        eta = np.geomspace(1e-12, 1e-8, 9)
        np.testing.assert_allclose(
            profiles.evaluate_profile(profile, eta, 0).value, start[1] * eta ** start[0], rtol=2e-15
        )
