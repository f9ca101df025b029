"""What a page keeps of a curve."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.cosim.reports.curve_data import MOST_POINTS, packed, spread, thinned, unpacked


@pytest.mark.parametrize("count", [1, 5, MOST_POINTS, MOST_POINTS + 1, 3 * MOST_POINTS + 7, 100_001])
def test_a_thinned_curve_keeps_ends_and_extremes(count: int) -> None:
    """And isn't longer than stated."""
    y = np.random.default_rng(count).normal(size=count)
    chosen = thinned(y)
    assert len(chosen) <= MOST_POINTS
    assert np.all(np.diff(chosen) > 0)
    assert {0, count - 1, int(y.argmin()), int(y.argmax())} <= set(chosen.tolist())
    assert (spread(count)[0], spread(count)[-1]) == (0, count - 1)


def test_a_gap_stays_a_gap() -> None:
    """Values that aren't finite don't hide others."""
    y = np.sin(np.linspace(0.0, 60.0, 30_000))
    y[10_000:20_000] = np.nan
    assert np.nanmax(y[thinned(y)]) == np.nanmax(y)
    assert np.isnan(y[thinned(y)]).any()


def test_numbers_come_back() -> None:
    """To 24 significant bits."""
    x = np.random.default_rng(0).normal(size=(3, 50))
    np.testing.assert_allclose(unpacked(packed(*x), 3), x, rtol=2.0**-24)
