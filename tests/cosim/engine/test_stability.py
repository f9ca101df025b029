"""A coupling that blows up is told apart from a system that moves fast, grows or resonates."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.cosim.engine.master.outcome import find_alternation, find_instability

TIME = 0.01 * np.arange(400)


@pytest.mark.parametrize(("multiplier", "growth"), [(-1.5, 1.5), (-20.0, 20.0), (1.3 * np.exp(1.2j), 1.3), (2.0, 2.0)])
def test_growth_from_step_to_step(multiplier: complex, growth: float) -> None:
    """Signals multiplied by a number beyond one in every step, alternating, turning or growing, are found, the fastest
    first."""
    count = 200 if abs(multiplier) < 10.0 else 100
    values = (np.power(complex(multiplier), np.arange(count))).real
    found = find_instability(TIME[:count], [("calm", np.sin(TIME[:count])), ("a.y", values)])
    assert found is not None
    assert found.signal == "a.y"
    assert found.growth == pytest.approx(growth, rel=0.15)
    assert found.since < 0.3


@pytest.mark.parametrize(
    "values",
    [
        np.exp(5.0 * TIME),
        np.exp(30.0 * TIME),
        TIME * np.sin(60.0 * TIME),
        np.exp(3.0 * TIME) * np.sin(60.0 * TIME),
        (-1.0) ** np.arange(400) * 1e3,
        np.where(np.arange(400) < 380, 0.0, 1.0),
        np.where(np.arange(400) < 10, 1.0, 1e9),
        1.0 / np.maximum(4.0 - TIME, 1e-9),
        np.zeros(400),
        TIME**6,
    ],
)
def test_what_is_no_instability_of_the_coupling(values: np.ndarray) -> None:
    """Growth that the steps resolve, resonance, chatter, jumps, poles and rest don't count."""
    assert find_instability(TIME, [("a.y", values)]) is None


def test_short_runs_are_not_judged() -> None:
    """A few steps prove nothing."""
    assert find_instability(TIME[:20], [("a.y", (-3.0) ** np.arange(20))]) is None
    assert find_instability(np.empty(0), [("a.y", np.empty(0))]) is None


def test_points_that_appear_twice_count_once() -> None:
    """At marks the right limit counts."""
    time = np.repeat(TIME[:100], 2)
    assert find_instability(time, [("a.y", np.repeat((-2.0) ** np.arange(100), 2))]) is not None


STEADY = (-1.0) ** np.arange(400)


@pytest.mark.parametrize("count", [7, 40])
def test_overshoot_from_step_to_step(count: int) -> None:
    """A loop that overshoots three times as far in every step is found after a few steps, also where a mechanism at its end
    takes the growth away."""
    values = np.concatenate([[0.0, 0.0], (-3.0) ** np.arange(count), [5.0, 4.0]])
    found = find_alternation(TIME[: values.size], [("calm", np.sin(TIME[: values.size])), ("pd.torque", values)])
    assert found is not None
    assert found.signal == "pd.torque"
    assert found.growth == pytest.approx(3.0, rel=0.1)
    assert found.since < 0.05


@pytest.mark.parametrize(
    "values",
    [
        1e3 * STEADY,
        STEADY * 0.9 ** np.arange(400),
        np.concatenate([1e-12 * 3.0 ** np.arange(20) * STEADY[:20], np.sin(TIME[:380])]),
        np.sin(3.1 * np.arange(400)) * np.sin(np.arange(400) / 7.0),
        np.concatenate([[1.0], np.zeros(380), 1e-3 * (-3.0) ** np.arange(8), np.zeros(11)]),
        STEADY * (1.0 + TIME),
        TIME * np.sin(60.0 * TIME),
        1.0 / np.maximum(4.0 - TIME, 1e-9),
        np.exp(30.0 * TIME),
        np.zeros(400),
    ],
)
def test_what_is_no_overshoot(values: np.ndarray) -> None:
    """Chatter, decay, rounding errors that alternate, beats, a vibration that comes up again, slow growth, resonance and
    poles don't count."""
    assert find_alternation(TIME, [("a.y", values)]) is None
    assert find_alternation(TIME[:2], [("a.y", values[:2])]) is None
    assert find_alternation(np.empty(0), [("a.y", np.empty(0))]) is None
