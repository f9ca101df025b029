"""A coupling that blows up is told apart from a system that moves fast, grows or resonates."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.cosim.engine.master.outcome import find_alternation, find_instability

TIME = 0.01 * np.arange(400)


STEADY = (-1.0) ** np.arange(400)


@pytest.mark.parametrize(("multiplier", "growth"), [(-1.5, 1.5), (-20.0, 20.0), (1.3 * np.exp(1.2j), 1.3), (2.0, 2.0)])
@pytest.mark.parametrize("sides", [1, 2])
def test_growth_from_step_to_step(multiplier: complex, growth: float, sides: int) -> None:
    """Signals multiplied by a number beyond one in every step, alternating, turning or growing, are found, the fastest
    first; of points that appear twice the right limit counts."""
    count = 200 if abs(multiplier) < 10.0 else 100
    values = (np.power(complex(multiplier), np.arange(count))).real
    time = np.repeat(TIME[:count], sides)
    found = find_instability(time, [("calm", np.sin(time)), ("a.y", np.repeat(values, sides))])
    assert found is not None
    assert found.signal == "a.y"
    assert found.growth == pytest.approx(growth, rel=0.15)
    assert found.since < 0.3


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
        np.exp(30.0 * TIME),
        TIME * np.sin(60.0 * TIME),
        np.exp(3.0 * TIME) * np.sin(60.0 * TIME),
        1e3 * STEADY,
        np.where(np.arange(400) < 380, 0.0, 1.0),
        np.where(np.arange(400) < 10, 1.0, 1e9),
        1.0 / np.maximum(4.0 - TIME, 1e-9),
        np.zeros(400),
        STEADY * 0.9 ** np.arange(400),
        np.concatenate([1e-12 * 3.0 ** np.arange(20) * STEADY[:20], np.sin(TIME[:380])]),
        np.sin(3.1 * np.arange(400)) * np.sin(np.arange(400) / 7.0),
        np.concatenate([[1.0], np.zeros(380), 1e-3 * (-3.0) ** np.arange(8), np.zeros(11)]),
        STEADY * (1.0 + TIME),
        *((-3.0) ** np.arange(20), np.empty(0)),
    ],
)
def test_what_is_no_fault_of_the_coupling(values: np.ndarray) -> None:
    """Growth that the steps resolve, resonance, chatter, jumps, poles, rest, decay, rounding errors that alternate, beats,
    a vibration that comes up again and slow growth don't count; a few steps prove no instability."""
    time = TIME[: values.size]
    assert find_instability(time, [("a.y", values)]) is None
    if values.size != 20:
        assert find_alternation(time, [("a.y", values)]) is None
    assert find_alternation(time[:2], [("a.y", values[:2])]) is None
