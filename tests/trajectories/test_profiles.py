"""Motion profiles against their closed forms."""

from __future__ import annotations

import inspect
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
    profiles,
)
from flexfmu.trajectories.profiles import time_at

PROFILES = (
    SeventhDegreePolynomial(),
    FifthDegreePolynomial(),
    BangBang(),
    Trapezoidal(0.25),
    Trapezoidal(0.125),
    Trapezoidal(0.5),
    DoubleS(0.25, 0.0625),
    DoubleS(0.5, 0.25),
    Harmonic(),
    Cycloidal(),
    ModifiedSine(),
    ModifiedTrapezoid(),
    PolynomialProfile((0.0, 0.0, 3.0, -2.0)),
)
seeded = settings(derandomize=True, deadline=None, max_examples=40)


@pytest.mark.parametrize("profile", PROFILES)
def test_every_profile_is_a_symmetric_motion_from_rest_to_rest(profile: Profile) -> None:
    """Protects ends, monotonicity and the point symmetry about the middle."""
    eta = np.linspace(0.0, 1.0, 401)
    motion = evaluate_profile(profile, eta, 3).derivatives()
    np.testing.assert_array_equal(motion[:2, [0, -1]], [[0.0, 1.0], [0.0, 0.0]])
    assert np.all(np.diff(motion[0]) > 0.0)
    mirrored = evaluate_profile(profile, eta, 3, side="left").derivatives()[:, ::-1]
    np.testing.assert_allclose(motion[0], 1.0 - mirrored[0], rtol=0, atol=5e-16)
    for order, sign in ((1, 1.0), (2, -1.0), (3, 1.0)):
        np.testing.assert_allclose(motion[order], sign * mirrored[order], rtol=0, atol=1e-12)


def test_seventh_degree_polynomial_is_exact_to_its_last_derivative() -> None:
    """Protects all derivatives, relative to their own size, also next to the ends: velocity is 140 η³ (1 - η)³."""
    eta = np.concatenate([np.geomspace(1e-12, 0.5, 100), 1.0 - np.geomspace(2.0**-40, 0.5, 100)])
    motion = evaluate_profile(SeventhDegreePolynomial(), eta, 8).derivatives()
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
        (SeventhDegreePolynomial(), 35.0 / 16.0, 84.0 * math.sqrt(5.0) / 25.0),
        (BangBang(), 2.0, 4.0),
        (Trapezoidal(0.25), 4.0 / 3.0, 16.0 / 3.0),
        (Trapezoidal(0.125), 8.0 / 7.0, 64.0 / 7.0),
        (FifthDegreePolynomial(), 15.0 / 8.0, 10.0 / math.sqrt(3.0)),
        (DoubleS(0.3, 0.1), 1.0 / 0.7, 1.0 / 0.7 / 0.2),
        (DoubleS(0.5, 0.25), 2.0, 8.0),
        (Harmonic(), math.pi / 2.0, math.pi**2 / 2.0),
        (Cycloidal(), 2.0, 2.0 * math.pi),
        (ModifiedSine(), 4.0 * math.pi / (4.0 + math.pi), 4.0 * math.pi**2 / (4.0 + math.pi)),
        (ModifiedTrapezoid(), 2.0, 8.0 * math.pi / (2.0 + math.pi)),
    ],
)
def test_peaks_have_their_closed_forms(profile: Profile, peak_velocity: float, peak_acceleration: float) -> None:
    """Protects velocity and acceleration, which scale every torque."""
    # peaks of the polynomials' accelerations are at the last two
    eta = np.append(np.linspace(0.0, 1.0, 4001), [0.5 - 0.1 * math.sqrt(5.0), 0.5 - math.sqrt(3.0) / 6.0])
    motion = evaluate_profile(profile, eta, 2).derivatives()
    assert motion[1].max() == pytest.approx(peak_velocity, rel=1e-14)
    assert motion[2].max() == pytest.approx(peak_acceleration, rel=1e-13)


@seeded
@given(st.floats(1e-3, 0.5))
def test_trapezoid_of_any_ramp_covers_the_path(ramp: float) -> None:
    """Protects the area under the velocity trapezoid, its jumps and the constant velocity 1/(1 - ramp)."""
    profile = Trapezoidal(ramp)
    jumps = np.array(profile.jumps)
    left, right = (evaluate_profile(profile, jumps, 2, side).derivatives() for side in ("left", "right"))
    np.testing.assert_allclose(left[:2], right[:2], rtol=1e-12, atol=1e-15)
    assert left[2, 0] == pytest.approx(1.0 / (ramp * (1.0 - ramp)), rel=1e-12)
    assert right[2, -1] == pytest.approx(-1.0 / (ramp * (1.0 - ramp)), rel=1e-12)
    assert evaluate_profile(profile, 0.5, 1).derivatives()[1, 0] == pytest.approx(1.0 / (1.0 - ramp), rel=1e-12)


def test_full_ramps_are_bang_bang() -> None:
    """Protects the trapezoid's limit, in which its middle part vanishes."""
    eta = np.linspace(0.0, 1.0, 101)
    assert Trapezoidal(0.5).jumps == BangBang().jumps
    np.testing.assert_allclose(
        evaluate_profile(Trapezoidal(0.5), eta, 3).coefficients,
        evaluate_profile(BangBang(), eta, 3).coefficients,
        rtol=0,
        atol=1e-15,
    )


@seeded
@given(st.sampled_from(PROFILES), st.floats(1e-6, 1.0 - 1e-6))
def test_times_of_passage_are_exact(profile: Profile, fraction: float) -> None:
    """Protects the times at which knots of the path are passed."""
    eta = time_at(profile, fraction)
    assert evaluate_profile(profile, eta, 0).value[0] == pytest.approx(fraction, rel=2e-15, abs=0)


@pytest.mark.parametrize("ramp", [0.0, -0.1, 0.5000001, math.nan, math.inf])
def test_ramps_out_of_range_are_refused(ramp: float) -> None:
    """Protects against ramps longer than the motion."""
    with pytest.raises(TrajectoryError, match=f"ramp must be above 0 and at most 0.5 of the duration, got {ramp:g}"):
        Trapezoidal(ramp)


def test_table_names_the_parameters_of_each_profile() -> None:
    """Protects scene files: their keys are the fields of the profile's class, and a key has one range for all profiles."""
    ranges: dict[str, profiles.Parameter] = {}
    for kind in profiles.PROFILES.values():
        assert set(inspect.signature(kind.make).parameters) == set(kind.parameters)
        for name, parameter in kind.parameters.items():
            assert ranges.setdefault(name, parameter) == parameter


@pytest.mark.parametrize("eta", [-1e-9, 1.1, math.nan])
def test_fractions_outside_the_motion_are_refused(eta: float) -> None:
    """Protects against extrapolated polynomials."""
    with pytest.raises(TrajectoryError, match="fraction of the duration must be between 0 and 1"):
        evaluate_profile(BangBang(), eta)
