"""Every coupling algorithm converges with the order that its polynomials allow, on an oscillator with closed form."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.engine.master.couplings import Algorithm, GaussSeidel, Implicit, Jacobi
from flexfmu.cosim.engine.master.iteration import Anderson, FixedPoint, Tolerance
from flexfmu.cosim.engine.master.simulator import Outcome, simulate

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
