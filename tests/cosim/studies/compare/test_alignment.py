"""The delay of a measurement: exact without noise, and within its stated error with noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.studies.compare.measured import TimedValues, correlation, difference, estimate_delay

SAMPLE = 1e-3


def signal(time: np.ndarray, number: int) -> np.ndarray:
    """A smooth motion that ends in a decaying vibration of 60 Hz, at rest before and after."""
    after = np.clip(time - 0.4, 0.0, None)
    pulse = np.exp(-(((time - 0.2) / 0.06) ** 2)) * np.sin(20.0 * time + number)
    return np.asarray(3.0 + 40.0 * pulse + 5.0 * np.exp(-20.0 * after) * np.sin(2.0 * np.pi * 60.0 * after))


def simulated(number: int = 0) -> TimedValues:
    """The signal as a simulation has it, with an instant that appears twice."""
    time = np.sort(np.append(np.linspace(0.0, 0.7, 3501), 0.4))
    return TimedValues(time, signal(time, number))


def measured(delay: float, noise: float = 0.0, seed: int = 0, number: int = 0, span: float = 1.0) -> TimedValues:
    """The signal at 1 kHz, later by a delay, with white noise."""
    time = 7.0 + np.arange(0.0, span, SAMPLE)
    random = np.random.default_rng([seed, number])
    return TimedValues(time, signal(time - delay, number) + noise * random.standard_normal(time.size))


@pytest.mark.parametrize("delay", [7.1, 7.0123456, 7.29999])
def test_a_known_delay_is_found_to_a_thousandth_of_a_sample(delay: float) -> None:
    """Without noise only the interpolation of the simulation is left."""
    found = estimate_delay([(measured(delay), simulated())])
    assert found.seconds == pytest.approx(delay, abs=1e-3 * SAMPLE)
    assert found.correlation == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_the_stated_error_is_that_of_noise(memory: float) -> None:
    """Over many draws of white and of coloured noise the error is as large as its standard error says, or a third larger."""
    delay, scaled, clean = 7.0123456, [], measured(7.0123456)
    for seed in range(100):
        shocks = np.sqrt(1.0 - memory**2) * np.random.default_rng(seed).standard_normal(clean.time.size)
        log = TimedValues(clean.time, clean.values + lfilter([1.0], [1.0, -memory], shocks))
        found = estimate_delay([(log, simulated())])
        assert 0.0 < found.error < 0.5 * SAMPLE
        scaled.append((found.seconds - delay) / found.error)
    # of 100 normally distributed numbers the root mean square is 1 ± 0.07
    assert 0.8 < np.sqrt(np.mean(np.square(scaled))) < 1.4


def test_several_signals_give_a_smaller_error() -> None:
    """All signals together, whatever their units."""
    pairs = [(measured(7.05, 1.0, 0, number), simulated(number)) for number in range(4)]
    milli = [(TimedValues(a.time, 1e3 * a.values), TimedValues(b.time, 1e3 * b.values)) for a, b in pairs[:2]]
    one, four = estimate_delay(pairs[:1]), estimate_delay([*milli, *pairs[2:]])
    assert four.error < 0.7 * one.error
    assert four.seconds == pytest.approx(7.05, abs=4.0 * four.error)


def test_an_offset_a_factor_and_a_short_or_long_log_do_no_harm() -> None:
    """The mean of a signal doesn't matter, nor that the log ends before the simulation, or lasts a minute in which the robot stands still
    but for one motion."""
    log = measured(7.02, span=0.5)
    changed = TimedValues(log.time, 1.2 * log.values - 50.0)
    assert estimate_delay([(changed, simulated())]).seconds == pytest.approx(7.02, abs=0.01 * SAMPLE)
    minute = estimate_delay([(measured(41.2345678, 0.5, span=60.0), simulated())])
    assert minute.seconds == pytest.approx(41.2345678, abs=0.3 * SAMPLE)


def test_differences_over_the_common_time() -> None:
    """RMS, mean and largest difference of a known one: an offset and a sine of whole periods."""
    time = np.linspace(-0.2, 1.2, 1401)
    log = TimedValues(time, signal(time, 0) + 0.5 + 0.2 * np.sin(2.0 * np.pi * 10.0 * time))
    found = difference(log, simulated(), 0.0)
    assert (found.time[0], found.time[-1]) == pytest.approx((0.0, 0.7))
    assert found.mean == pytest.approx(0.5, abs=1e-4)
    assert found.root_mean_square == pytest.approx(np.hypot(0.5, 0.2 / np.sqrt(2.0)), abs=1e-4)
    assert found.largest == pytest.approx(0.7, abs=1e-3)
    assert found.relative == pytest.approx(found.root_mean_square / np.ptp(found.measured))


def test_what_cannot_be_aligned() -> None:
    """Constant signals, and signals without a common time, are refused; the wrong sign shows in the correlation."""
    flat = TimedValues(np.linspace(0.0, 1.0, 100), np.ones(100))
    with pytest.raises(InputError, match="no signal changes in both"):
        estimate_delay([(flat, simulated())])
    with pytest.raises(InputError, match=r"overlap in 0 samples only: with a delay of 0 s .* from 7 to 7\.999 s"):
        difference(measured(7.0), simulated(), 0.0)
    log = measured(7.0)
    assert correlation([(TimedValues(log.time, -log.values), simulated())], 7.0) == pytest.approx(-1.0, abs=1e-4)
