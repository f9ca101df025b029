"""Spectra of the residual: known sines give known peaks."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.cosim.reports.chart import Curve
from flexfmu.cosim.reports.spectrum import peak, spectrum, spectrum_panel


@pytest.mark.parametrize("frequency", [41.3, 58.0, 77.77])
@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_a_sine_peaks_at_its_frequency_with_its_amplitude(frequency: float, phase: float) -> None:
    """Whether or not it lasts a whole number of periods, on top of a mean, and without what was before."""
    time = np.arange(0.0, 1.0, 2e-4)
    values = 3.0 + 2.5 * np.sin(2.0 * np.pi * frequency * time + phase)
    values[time < 0.4] = 100.0
    found = spectrum(time, values, 0.4)
    assert found is not None
    at, height = peak(*found)
    assert at == pytest.approx(frequency, abs=0.05)
    assert height == pytest.approx(2.5, rel=2e-3)


def test_unequal_steps_and_double_instants_change_nothing() -> None:
    """A recording has jumps twice, and steps that were chosen."""
    rng = np.random.default_rng(1)
    time = np.sort(np.concatenate([np.linspace(0.0, 0.5, 4001), rng.uniform(0.0, 0.5, 2000), [0.25, 0.25]]))
    found = spectrum(time, np.sin(2.0 * np.pi * 30.0 * time), 0.0)
    assert found is not None
    assert peak(*found) == (pytest.approx(30.0, abs=0.05), pytest.approx(1.0, rel=3e-3))


def test_too_little_is_no_spectrum() -> None:
    """A run that ends with its motion, and values that aren't finite."""
    time = np.linspace(0.0, 1.0, 100)
    assert spectrum(time, time, 0.99) is None
    assert spectrum(time, np.full(100, np.nan), 0.0) is None
    assert spectrum_panel("y", []).curves == ()


def test_the_panel_names_its_highest_peak() -> None:
    """And leaves out what lies three decades below."""
    time = np.arange(0.0, 2.0, 1e-3)
    found = spectrum(time, np.sin(2.0 * np.pi * 60.0 * time) + 1e-5 * np.sin(2.0 * np.pi * 300.0 * time), 0.0)
    assert found is not None
    panel = spectrum_panel("y", [Curve(*found)], [(59.0, "mode 1"), (400.0, "mode 2")])
    assert panel.markers[0].text == "60 Hz"
    assert panel.limits is not None
    assert 60.0 < panel.limits[1] < 200.0
    assert [text for _, text in panel.marks] == ["mode 1"]


def test_a_spectrum_far_below_another_changes_nothing() -> None:
    """A motion without vibration beside one with it."""
    time = np.arange(0.0, 2.0, 1e-3)
    found = spectrum(time, np.sin(2.0 * np.pi * 60.0 * time), 0.0)
    assert found is not None
    loud, quiet = Curve(*found), Curve(found[0], 1e-6 * found[1])
    assert spectrum_panel("y", [loud, quiet]).limits == spectrum_panel("y", [loud]).limits
