"""Whole and fractional delays against shifts, polynomials and the filters' theory."""

from __future__ import annotations

import re
from functools import partial
from typing import Any

import numpy as np
import pytest
from blocks import delay, sampled
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import group_delay, lfilter

from flexfmu.cosim.control.imperfections.delay import VECTORISED_FROM, DelayFilter, lagrange, thiran
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene

H = 1e-3
Rule = dict[str, Any]
LINEAR: Rule = {"kind": "linear"}
START: Any = {"signal": "position", "initial": (0.7, 0.7)}


def rule(kind: str, order: int) -> Rule:
    """An interpolation of a section."""
    return {"kind": kind, "order": order}


ORDERS = st.integers(1, 10)
EXTRA = st.integers(0, 300).map(lambda hundredths: hundredths / 100)
"""What a delay is above the shortest one of its filter, in samples."""


def transfer(design: DelayFilter) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator in powers of 1/z."""
    return np.array([*[0.0] * design.whole, *design.numerator]), np.array([1.0, *design.denominator])


@pytest.mark.parametrize("samples", [0, 1, 2, 7, VECTORISED_FROM // 2 + 1, 400])
def test_whole_delays_are_exact(samples: int) -> None:
    """Every value comes out n samples later, to the last bit, and the initial value before."""
    u = np.random.default_rng(samples).normal(size=(samples + 30, 2))
    y = sampled(delay(samples * H, sample_time=H, initial=(3.0, -1.0)), u)
    np.testing.assert_array_equal(y[:samples], np.tile([3.0, -1.0], (samples, 1)))
    np.testing.assert_array_equal(y[samples:], u[:30])


@pytest.mark.parametrize(
    "interpolation", [LINEAR, rule("lagrange", 2), rule("lagrange", 5), rule("thiran", 1), rule("thiran", 3)]
)
@pytest.mark.parametrize(("time", "sample_time"), [(0.3, 0.1), (7e-3, 1e-3), (0.6, 0.2), (12 / 7000, 1 / 7000)])
def test_whole_times_are_whole_delays(interpolation: Rule, time: float, sample_time: float) -> None:
    """A multiple of the sample time, rounded as it may be, is an exact shift for every interpolation."""
    n = round(time / sample_time)
    u = np.random.default_rng(1).normal(size=40)
    y = sampled(delay(time, interpolation, sample_time=sample_time, **START), u)[:, 0]
    np.testing.assert_array_equal(y, [*[0.7] * n, *u[:-n]])


@settings(max_examples=40)
@given(order=ORDERS, extra=EXTRA)
def test_lagrange_is_exact_for_polynomials(order: int, extra: float) -> None:
    """A polynomial of the filter's order comes out as the same polynomial, delayed, once the line is filled."""
    samples = (order - 1) / 2 + extra
    polynomial = np.polynomial.Polynomial(np.random.default_rng(order).normal(size=order + 1), domain=[0, 30])
    k = np.arange(31.0)
    y = sampled(delay(samples * H, rule("lagrange", order), sample_time=H, **START), polynomial(k))[:, 0]
    filled = k >= order + extra + 1
    scale = np.abs(polynomial(k)).max()
    np.testing.assert_allclose(y[filled], polynomial(k - samples)[filled], rtol=0, atol=1e-12 * scale)


@settings(max_examples=60)
@given(order=ORDERS, extra=EXTRA)
def test_lagrange_amplifies_nothing(order: int, extra: float) -> None:
    """In a control loop a delay that amplified some frequency would look like a loss of gain margin."""
    b, _ = transfer(lagrange(order, (order - 1) / 2 + extra))
    response = np.abs(np.polyval(b, np.exp(1j * np.linspace(0.0, np.pi, 400))))
    assert response.max() <= 1.0 + 1e-12


@settings(max_examples=60)
@given(order=ORDERS, extra=EXTRA)
def test_thiran_passes_every_amplitude_and_is_stable(order: int, extra: float) -> None:
    """All-pass: the magnitude is 1 at every frequency; its poles lie inside the unit circle."""
    b, a = transfer(thiran(order, order - 0.5 + extra))
    z = np.exp(1j * np.linspace(0.0, np.pi, 200))
    np.testing.assert_allclose(np.abs(np.polyval(b[::-1], 1 / z) / np.polyval(a[::-1], 1 / z)), 1.0, atol=1e-9)
    assert (np.abs(np.roots(a)) < 1.0).all()


@settings(max_examples=60)
@given(order=st.integers(1, 6), extra=EXTRA, is_thiran=st.booleans())
def test_group_delay_is_flat_at_zero_frequency(order: int, extra: float, is_thiran: bool) -> None:
    """The group delay is the delay asked for."""
    samples = (order - 0.5 if is_thiran else (order - 1) / 2) + extra
    design = (thiran if is_thiran else lagrange)(order, samples)
    assert design.samples == pytest.approx(samples, abs=1e-10)
    _, found = group_delay(transfer(design), w=[1e-3, 1e-2])
    np.testing.assert_allclose(found, samples, rtol=0, atol=1e-4)


@pytest.mark.parametrize("interpolation", [LINEAR, rule("lagrange", 3), rule("thiran", 1), rule("thiran", 4)])
def test_block_equals_the_filter(interpolation: Rule) -> None:
    """The block is SciPy's lfilter with the same coefficients, beginning at rest in the initial value."""
    u = np.random.default_rng(4).normal(size=200)
    y = sampled(delay(4.37 * H, interpolation, sample_time=H, **START), u)[:, 0]
    design = partial(thiran if interpolation["kind"] == "thiran" else lagrange, interpolation.get("order", 1))
    expected = 0.7 + lfilter(*transfer(design(4.37)), u - 0.7)
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-13)


def test_a_short_delay_feeds_through() -> None:
    """Below one sample the newest value counts, from one sample on it doesn't; the master must know."""
    feeding = ("joint1.position.input",)
    for samples, expected in ((0.4, feeding), (1.0, ()), (1.4, ())):
        assert delay(samples * H, sample_time=H, **START).feedthrough["joint1.position"] == expected
    assert delay(1.2 * H, rule("thiran", 1), sample_time=H, **START).feedthrough["joint1.position"] == feeding
    assert delay(0.0, sample_time=H).states == ()


def test_vectorised_and_scalar_lines_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    """Long memories use other operations of CasADi; they must do the same."""
    u = np.random.default_rng(5).normal(size=(300, 2))
    results = []
    for limit in (0, 10**6):
        monkeypatch.setattr("flexfmu.cosim.control.imperfections.delay.VECTORISED_FROM", limit)
        results.append(sampled(delay(60.4 * H, rule("thiran", 2), sample_time=H, initial=(0.1, 0.2)), u))
    np.testing.assert_array_equal(*results)


@settings(max_examples=40, deadline=None)
@given(late=st.integers(0, 6) | EXTRA, longest=st.floats(0.0, 40.0), seed=st.integers(0, 99))
def test_a_tunable_delay_has_the_bits_of_a_fixed_one(late: float, longest: float, seed: int) -> None:
    """Zero, whole samples and fractions, with and without values before the first sample, with scalar and with vector operations."""
    u, initial = np.random.default_rng(seed).normal(size=(20, 2)), (0.3, -0.2) if seed % 2 else ()
    given = {"signal": "position", "sample_time": H, "initial": initial}
    tunable = delay(0.0, longest=(late + longest) * H, **given)
    np.testing.assert_array_equal(sampled(tunable, u, {"time": late * H}), sampled(delay(late * H, **given), u))


def test_a_tunable_delay_is_linear_and_no_longer_than_the_longest() -> None:
    scene = load_scene("barnard2012-6kg")
    for changes, message in (
        ({"interpolation": {"kind": "thiran", "order": 2}}, 'needs `interpolation = "linear"`, got "thiran"'),
        ({"time": 5e-3}, "`longest` must be at least `time`, 0.005 s, got 0.004 s"),
    ):
        section = {"kind": "delay", "time": 2e-3, "longest": 4e-3} | changes
        with pytest.raises(SceneError, match=re.escape(message)):
            scene.replace({"imperfection": [section]})
