"""Grids and sample times: instants are integers, marks are hit exactly, what doesn't fit is refused, delays are said; and coupling algorithms
converge with the order that their polynomials allow, on an oscillator with closed form."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from python_slave import PythonSlave, SampledSlave

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.couplings import Algorithm, GaussSeidel, Implicit, Jacobi, Transport
from flexfmu.cosim.engine.master.grid import Clock, time_grid
from flexfmu.cosim.engine.master.iteration import Anderson, FixedPoint, Tolerance
from flexfmu.cosim.engine.master.outcome import SignalDelay
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import COINCIDENT, SlaveVariable


class Sampler(SampledSlave):
    """Puts out its input of one sample earlier, y_k = x_k, x_k+1 = u_k, and notes its instants."""

    variables = (SlaveVariable("u", "input", start=0.0), SlaveVariable("y", "output", start=-1.0))
    feedthrough = {"y": ()}  # noqa: RUF012

    def __init__(self, name: str, sample_time: float, offset: float = 0.0, start: float = 0.0) -> None:
        super().__init__(name)
        self.sample_time, self.offset, self.x = sample_time, offset, start
        self.times: list[float] = []

    def sample(self, time: float) -> None:
        self.times.append(time)
        self.memory[1], self.x = self.x, float(self.memory[0])


class InTwoPhases(Sampler):
    """The same, in two phases."""

    def output(self, time: float) -> None:
        self.memory[1] = self.x

    def update(self, time: float) -> None:
        self.times.append(time)
        self.x = float(self.memory[0])


class Counter(PythonSlave):
    """A stepped slave that passes on its input."""

    name = "plant"
    feedthrough = {"x": ()}  # noqa: RUF012
    variables = (SlaveVariable("u", "input", start=0.0), SlaveVariable("x", "output", start=1.0))

    def step(self, time: float, step: float) -> None:
        self.memory[1] += self.memory[0]


@pytest.mark.parametrize(
    ("sample_time", "offset", "step"), [(2e-4, 0.0, 2e-4), (1e-3, 3e-4, 1e-4), (2.5e-4, 5e-5, 1e-4), (1 / 3e3, 0, 1e-3)]
)
def test_instants_are_exact_over_many_samples(sample_time: float, offset: float, step: float) -> None:
    """After 1e5 samples every instant is still offset + k * sample_time to the last two digits, and none is doubled."""
    count = 100_000
    clock = Clock("controller", sample_time, offset)
    stop = offset + sample_time * count
    grid = time_grid(0.0, stop, step, clocks=[clock])
    instants = grid.times[grid.due[0]]
    np.testing.assert_array_max_ulp(instants, offset + sample_time * np.arange(count + 1), 2)
    assert np.diff(grid.times).min() > 0.1 * step / Fraction(sample_time / step).limit_denominator(10).denominator
    assert np.unique(np.rint(grid.times / (step / 60.0))).size == grid.times.size


def test_rates_meet_exactly() -> None:
    """Where two clocks and the communication grid fall together they share one point, also after 1e5 steps."""
    clocks = [Clock("fast", 1e-4), Clock("slow", 3e-4, 2e-4), Clock("odd", 7e-5)]
    grid = time_grid(0.0, 10.0, 1e-4, clocks=clocks)
    numbers = np.rint(grid.times / 1e-5).astype(int)
    assert np.unique(numbers).size == numbers.size
    np.testing.assert_array_equal(grid.due[0], numbers % 10 == 0)
    np.testing.assert_array_equal(grid.due[1], (numbers % 30 == 20) & (numbers >= 20))
    np.testing.assert_array_equal(grid.due[2], numbers % 7 == 0)


def test_a_slave_is_sampled_at_its_instants() -> None:
    """Offset and sample time as given; before its first sample a slave's output is as it was initialised."""
    sampler = Sampler("controller", 0.25, 0.1)
    result = simulate(connect([sampler, Counter()], [("plant.x", "controller.u")]), 1.0, 0.1)
    assert result.outcome is Outcome.COMPLETED, result.message
    np.testing.assert_allclose(sampler.times, [0.1, 0.35, 0.6, 0.85], rtol=1e-15)
    y = result.recording["controller.y"].values
    assert set(y[result.recording.time < 0.1].tolist()) == {-1.0}


def test_a_held_output_arrives_at_once() -> None:
    """What a slave puts out at its sample instant drives the plant from that instant on, though it needs no input for
    it and could be visited early: x grows by -1 before the first sample, then by the start state, then by what was
    read one sample earlier."""
    sampler = Sampler("controller", 0.2, start=5.0)
    system = connect([sampler, Counter()], [("controller.y", "plant.u"), ("plant.x", "controller.u")])
    result = simulate(system, 0.6, 0.1)
    times = result.recording.time
    last = np.append(np.diff(times) > 0.0, True)
    # u: 5 at 0 and 0.1; then x(0) = 1 at 0.2 and 0.3, with both limits; then x(0.2) = 11 at 0.4 and 0.5
    assert result.recording["controller.y"].values[times == 0.2].tolist() == [5.0, 1.0]
    assert result.recording["plant.x"].values[last].tolist() == [1.0, 6.0, 11.0, 12.0, 13.0, 24.0, 35.0]
    assert [each.seconds for each in result.delays] == [0.0, 0.0]
    assert [each.average for each in result.delays] == pytest.approx([0.1, 0.0])
    assert [str(each) for each in result.delays] == [
        "controller.y -> plant.u: 0.1 s late on average, held for 0.2 s between the samples of its source",
        "plant.x -> controller.u: no delay, read at the sample instants",
    ]


def test_a_ring_of_sampled_slaves() -> None:
    """Two delays of one sample in a ring: in two phases a sample goes round in two sample times. In one call, one of them
    has to sample first, before the other's new output is there: the run says that this signal is one sample late."""
    wires = [("a.y", "b.u"), ("b.y", "a.u")]
    two = simulate(connect([InTwoPhases("a", 0.1, start=1.0), InTwoPhases("b", 0.1)], wires), 0.6, 0.1)
    last = np.append(np.diff(two.recording.time) > 0.0, True)
    assert two.recording["a.y"].values[last].tolist() == [1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0]
    assert [each.seconds for each in two.delays] == [0.0, 0.0]
    one = simulate(connect([Sampler("a", 0.1, start=1.0), Sampler("b", 0.1)], wires), 0.6, 0.1)
    assert sorted(each.seconds for each in one.delays) == [0.0, 0.1]
    assert "0.1 s late, its source has sampled that long before its target" in str([*map(str, one.delays)])
    # so does one that feeds itself
    for kind, late in ((Sampler, 0.1), (InTwoPhases, 0.0)):
        (delay,) = simulate(connect([kind("a", 0.1)], [("a.y", "a.u")]), 0.3, 0.1).delays
        assert delay.seconds == late


@pytest.mark.parametrize(
    ("source", "target", "age", "mean"),
    [
        ((0.2, 0.0), (0.2, 0.1), 0.1, 0.1),
        ((0.2, 0.1), (0.2, 0.0), 0.1, 0.1),
        ((0.1, 0.0), (0.2, 0.0), 0.0, 0.0),
        ((0.3, 0.0), (0.2, 0.0), 0.2, 0.1),
        ((0.4, 0.0), (0.1, 0.0), 0.3, 0.15),
    ],
)
def test_the_age_of_a_sample(source: tuple[float, float], target: tuple[float, float], age: float, mean: float) -> None:
    """A slave that samples between the samples of another reads what has been held since: the list of delays says how
    long, at most and on average."""
    slaves = [InTwoPhases("a", *source), InTwoPhases("b", *target)]
    (delay,) = simulate(connect(slaves, [("a.y", "b.u")]), 1.2, 0.1).delays
    assert delay.seconds == pytest.approx(age, abs=1e-12)
    assert delay.average == pytest.approx(mean, abs=1e-12)
    assert ("on average" in str(delay)) == (mean < age)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_the_age_of_an_extrapolated_signal(order: int) -> None:
    """The polynomial of the last point, evaluated over a step of a ramp, lags by this time on average."""
    step = 0.2
    within = (np.arange(1000) + 0.5) / 1000 * step
    seen = within if order else np.zeros(1000)  # value and rate at the last point, or the value alone
    delay = SignalDelay("a.y -> b.u", step, Transport.EXTRAPOLATED, order, latency=0.05)
    assert delay.average == pytest.approx(0.05 + np.mean(within - seen), abs=1e-12)


def test_no_drift_after_many_steps() -> None:
    """After 1e5 steps a communication point is still start + n * step to the last digit, and marks are hit exactly; one beside a
    tick makes no step of rounding errors, nor do two beside each other."""
    marks = [1e-13, 1.0 / 3.0, 7.77, 7.77 + 1e-12, 8.1234 + 1e-13]
    grid = time_grid(0.0, 10.0, 1e-4, marks)
    assert grid.times.size == 100_001 + 1  # all but 1 / 3 s are ticks, but for rounding
    assert grid.times[-1] == 10.0
    assert grid.times[grid.marked].tolist() == [0.0, *marks[1:3], marks[4]]
    ticks = grid.times[~grid.marked & (grid.times < 10.0)]
    np.testing.assert_array_equal(ticks, np.rint(ticks / 1e-4) * 1e-4)


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


def test_a_sample_time_far_below_the_step_is_refused_with_values_that_do() -> None:
    """What is recommended isn't what was given: both recommendations make a grid."""
    with pytest.raises(InputError, match=r"take at least 2e-07 s, or a communication step of at most 0\.0001 s"):
        time_grid(0.0, 1e-3, 2e-4, clocks=[Clock("pd", 1e-7)])
    assert time_grid(0.0, 1e-3, 2e-4, clocks=[Clock("pd", 2e-7)]).times.size == 5001
    assert time_grid(0.0, 1e-3, 1e-4, clocks=[Clock("pd", 1e-7)]).times.size == 10001


Factory = Callable[..., Any]


def error(make: Factory, order: int, algorithm: Algorithm, step: float) -> float:
    """Error after a second [m]."""
    oscillator = make(order)
    result = simulate(oscillator.system(), stop=1.0, step=step, algorithm=algorithm)
    assert result.outcome is Outcome.COMPLETED, result.message
    return float(oscillator.error(result.recording))


TIGHT = Implicit(Anderson(tolerance=Tolerance(relative=1e-14, absolute=1e-14)))


@pytest.mark.parametrize(
    ("algorithm", "order", "expected", "step", "largest"),
    [
        *((Jacobi(), order, order + 1, 0.01, 1.0) for order in range(4)),
        *((GaussSeidel(), order, order + 1, 0.01, 10.0 ** (-1 - 1.7 * order)) for order in range(4)),
        *((TIGHT, order, 2 * order + 2, 0.1, 1.0) for order in range(3)),
    ],
)
def test_orders(
    split_oscillator: Factory, algorithm: Algorithm, order: int, expected: int, step: float, largest: float
) -> None:
    """With k derivatives: k + 1 side by side, by extrapolation, and one after the other, where that closes the loop;
    2 k + 2 by interpolation between both ends of the repeated step."""
    coarse, fine = (error(split_oscillator, order, algorithm, each) for each in (step, step / 2.0))
    assert np.log2(coarse / fine) == pytest.approx(expected, abs=0.3)
    assert coarse < largest


def test_the_order_of_slaves_does_not_matter_side_by_side(split_oscillator: Factory) -> None:
    """Jacobi gives the same numbers whichever slave comes first."""
    one, other = split_oscillator(2), split_oscillator(2)
    other.slaves.reverse()
    first, second = (simulate(each.system(), 1.0, 0.02, algorithm=Jacobi()).recording for each in (one, other))
    for name in ("left.x", "left.v", "right.x", "right.v"):
        np.testing.assert_array_equal(first[name].values, second[name].values)


@pytest.mark.parametrize("solver", [Anderson(), FixedPoint(), FixedPoint(relaxation=0.7)])
def test_solvers_agree(split_oscillator: Factory, solver: Anderson | FixedPoint) -> None:
    """What is found doesn't depend on how; all states are let go again."""
    reference, oscillator = split_oscillator(1), split_oscillator(1)
    exact = simulate(reference.system(), 1.0, 0.05, algorithm=TIGHT)
    result = simulate(oscillator.system(), 1.0, 0.05, algorithm=Implicit(solver))
    np.testing.assert_allclose(result.recording["left.x"].values, exact.recording["left.x"].values, atol=1e-8)
    assert [slave.saved for slave in oscillator.slaves] == [0, 0]


def test_delays_are_stated(split_oscillator: Factory) -> None:
    """The run says which signal is how old, as numbers and in words."""
    one_way = simulate(split_oscillator(0).system(), 1.0, 0.02)
    assert [each.seconds for each in one_way.delays] == pytest.approx([0.02, 0.02])
    derivatives = simulate(split_oscillator(2).system(), 1.0, 0.02)
    assert [each.seconds for each in derivatives.delays] == [0.0, pytest.approx(0.02)]
    assert [str(each) for each in derivatives.delays] == [
        "left.x -> right.u: no delay, interpolated between both ends of the step",
        "right.x -> left.u: up to 0.02 s old, extrapolated from the beginning of the step with 2 derivatives",
    ]
    both = simulate(split_oscillator(0).system(), 1.0, 0.02, algorithm=Jacobi())
    assert str(both.delays[0]) == "left.x -> right.u: up to 0.02 s late, held over the step"
    implicit = simulate(split_oscillator(1).system(), 1.0, 0.02, algorithm=Implicit())
    assert [each.seconds for each in implicit.delays] == [0.0, 0.0]


def test_an_unsolved_step_is_an_outcome(split_oscillator: Factory) -> None:
    """A step that can't be made to agree ends the run with the loop's name, what is left, and a remedy; the results up to
    there are kept."""
    solver = FixedPoint(rounds=2, tolerance=Tolerance(1e-14, 1e-14))
    result = simulate(split_oscillator(1).system(), 1.0, 0.1, algorithm=Implicit(solver))
    assert result.outcome is Outcome.LOOP_NOT_SOLVED
    assert "the loop right.x -> left.u isn't solved at 0.1 s: after 2 rounds der(right.x,1) still" in result.message
    assert "smaller communication step" in result.message
    assert result.recording.time.tolist() == [0.0]


def test_stiff_couplings(split_oscillator: Factory) -> None:
    """A coupling spring that makes the explicit algorithms explode is named as the cause; repeated steps stay bounded."""
    unstable = simulate(split_oscillator(0, coupling=1e4).system(), 20.0, 0.1, algorithm=Jacobi())
    assert unstable.outcome is Outcome.COUPLING_UNSTABLE
    assert "-fold from step to step" in unstable.message
    assert "Implicit()" in unstable.message
    implicit = simulate(split_oscillator(1, coupling=1e4).system(), 20.0, 0.02, algorithm=Implicit())
    assert implicit.outcome is Outcome.COMPLETED
    assert abs(implicit.recording["left.x"].values).max() < 1.5
