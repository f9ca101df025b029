"""The time grid: integer ticks, marks hit exactly, no drift."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.grid import Clock, time_grid
from flexfmu.cosim.engine.slave import COINCIDENT


def test_no_drift_after_many_steps() -> None:
    """After 1e5 steps a communication point is still start + n * step to the last digit, and marks are hit exactly."""
    marks = [1.0 / 3.0, 7.77]
    grid = time_grid(0.0, 10.0, 1e-4, marks)
    assert grid.times.size == 100_001 + 1  # 7.77 is a tick, but for rounding
    assert grid.times[-1] == 10.0
    assert set(marks) <= set(grid.times.tolist())
    ticks = grid.times[~np.isin(grid.times, [*marks, 10.0])]
    np.testing.assert_array_equal(ticks, np.rint(ticks / 1e-4) * 1e-4)
    assert grid.times[grid.marked].tolist() == marks


@settings(max_examples=200)
@given(
    start=st.floats(-10.0, 10.0),
    span=st.floats(1e-3, 10.0),
    count=st.floats(0.3, 500.0),
    shares=st.lists(st.floats(-0.2, 1.2), max_size=8),
)
def test_grid_properties(start: float, span: float, count: float, shares: list[float]) -> None:
    """Whatever the marks: points increase, no step is too long or vanishes, start, stop and inner marks are points."""
    stop, step = start + span, span / count
    marks = [start + share * span for share in shares]
    grid = time_grid(start, stop, step, marks)
    steps = np.diff(grid.times)
    assert grid.times[0] == start
    assert grid.times[-1] == stop
    assert (steps > 0.99 * COINCIDENT * step).all()
    assert (steps < step * (1.0 + 3.0 * COINCIDENT) + 1e-14).all()
    for mark in marks:
        if start <= mark <= stop:
            nearest = abs(grid.times - mark).argmin()
            assert abs(grid.times[nearest] - mark) <= COINCIDENT * step
            assert grid.marked[nearest]


def test_near_coincident_marks_are_one_point() -> None:
    """A tick beside a breakpoint doesn't make a step of rounding errors, nor do two breakpoints beside each other."""
    grid = time_grid(0.0, 1.0, 0.1, [0.3 + 1e-12, 0.3 + 2e-12, 1e-13])
    assert grid.times.size == 11
    assert grid.times[3] == 0.3 + 1e-12
    assert grid.marked.tolist() == [n in (0, 3) for n in range(11)]


def test_a_sample_time_far_below_the_step_is_refused_with_values_that_do() -> None:
    """What is recommended isn't what was given: both recommendations make a grid."""
    with pytest.raises(InputError, match=r"take at least 2e-07 s, or a communication step of at most 0\.0001 s"):
        time_grid(0.0, 1e-3, 2e-4, clocks=[Clock("pd", 1e-7)])
    assert time_grid(0.0, 1e-3, 2e-4, clocks=[Clock("pd", 2e-7)]).times.size == 5001
    assert time_grid(0.0, 1e-3, 1e-4, clocks=[Clock("pd", 1e-7)]).times.size == 10001
