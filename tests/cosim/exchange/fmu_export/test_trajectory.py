"""A trajectory's FMU gives the trajectory: everywhere, on both sides of its breakpoints, with its derivatives."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, pi
from typing import Any

import numpy as np
import pytest
from export_support.instance import Instance, RefusedError
from export_support.trajectories import Swing, lame, robot

from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.trajectory_build import Motion
from flexfmu.fmu_build.trajectory_table import END_ORDER, tabulate
from flexfmu.trajectories.path import ClothoidPair, PolarPolynomial
from flexfmu.trajectories.profiles import bang_bang, double_s, seventh_degree_polynomial, trapezoidal
from flexfmu.trajectories.shapers.sequence import ImpulseSequence, ShapedTrajectory
from flexfmu.trajectories.sources import as_trajectory

SWING = Swing()

PROMISE = 1e-12
"""Difference to the Python trajectory, relative to the largest value of the same kind."""

LEFT, RIGHT = 1, 2


class Arch:
    """An own motion: 20 cm to the right over an arch."""

    duration = 0.4

    def position(self, time: float) -> tuple[float, float]:
        """x and y [m]."""
        angle = pi * (1.0 - cos(pi * time / self.duration)) / 2.0
        return -0.1 * cos(angle), 0.02 * cos(angle) ** 2


ROBOT = {
    "lame-poly7": lambda: lame(seventh_degree_polynomial()),
    "lame-bang-bang": lambda: lame(bang_bang()),
    "clothoid-trapezoidal": lambda: robot(ClothoidPair, trapezoidal(0.2)),
    "polar-bang-bang": lambda: robot(PolarPolynomial, bang_bang()),
    "lame-double-s": lambda: lame(double_s(0.3, 0.1)),
    "own": lambda: as_trajectory(Arch()),
    "shaped": lambda: ShapedTrajectory(lame(bang_bang()), ImpulseSequence((0.0, 0.0123, 0.03), (0.5, 0.3, 0.2))),
}


@pytest.fixture
def swing(export: Callable[..., Any]) -> Callable[..., Instance]:
    """Makes instances of a swing's FMU."""
    make: Callable[..., Instance] = export(Motion(SWING, ["axis"], "m"))  # type: ignore[arg-type]
    return make


def choose(instance: Instance, limit: int) -> None:
    """Choose the limit that is shown at breakpoints."""
    instance.call("setInteger", [0], [limit])


def follow(instance: Instance, times: Any, start: float = 0.0) -> dict[int, Any]:
    """Left and right limits of the outputs at the times, each (N, 3, axes)."""
    instance.start(time=start)
    rows: dict[int, list[Any]] = {LEFT: [], RIGHT: []}
    for time in times:
        instance.step(time - instance.time, until=time)
        for limit, found in rows.items():
            choose(instance, limit)
            found.append(np.reshape(instance.get_outputs(), (3, -1)))
    return {limit: np.array(found) for limit, found in rows.items()}


@pytest.mark.parametrize("name", ROBOT)
def test_table_reproduces_the_trajectory(export: Callable[..., Any], name: str) -> None:
    """A plant that is fed by the FMU must move as one that is fed by the Python trajectory. At a breakpoint there are knots, and
    the polynomials begin and end in them: no rounding, no neighbouring piece."""
    trajectory = ROBOT[name]()
    points = trajectory.breakpoints[1:]
    times = np.union1d(np.random.default_rng(2).uniform(0.0, 1.1 * trajectory.duration, 1000), points)
    found = follow(export(Motion(trajectory))(), times)
    for limit, side in ((LEFT, "left"), (RIGHT, "right")):
        exact = trajectory.evaluate(times, 2, side).swapaxes(0, 1)
        largest = abs(exact).max(axis=(0, 2))[:, None]
        assert (abs(found[limit] - exact) / largest).max() < PROMISE
        at = np.isin(times, points)
        np.testing.assert_array_equal(found[limit][at], exact[at])
        if "bang-bang" in name:
            assert (found[LEFT] != found[RIGHT])[at, 2].any(), "the acceleration jumps"


def test_both_limits_at_the_start(swing: Callable[..., Instance]) -> None:
    """The motion begins with a jump: standstill is the left limit, and the default."""
    instance = swing().start()
    assert instance.get_outputs() == [0.0, 0.0, 0.0]
    choose(instance, RIGHT)
    assert instance.get_outputs() == SWING.evaluate(0.0).ravel().tolist()
    assert instance.get_outputs()[1] == 9.0
    assert instance.get_derivatives(1) == pytest.approx(SWING.evaluate(0.0, 3).ravel()[1:], rel=1e-14)


def test_breakpoint_is_met_in_spite_of_rounding(swing: Callable[..., Instance]) -> None:
    """Importers reach 0.4 s by adding up 0.1 s; the left limit must not come from behind the kink."""
    instance = swing().start()
    for nearly in (0.1, 0.2, 0.1 + 0.2, SWING.kink * (1 + 1e-15)):
        instance.step(nearly - instance.time, until=nearly)
    for limit, side in ((LEFT, "left"), (RIGHT, "right")):
        choose(instance, limit)
        assert instance.get_outputs() == SWING.evaluate(SWING.kink, 2, side).ravel().tolist()


def test_derivatives_of_the_outputs(swing: Callable[..., Instance]) -> None:
    """Orders 1 to 4, so that a master streams polynomials: those of the position are velocity and acceleration
    themselves, the highest is the sixth derivative of the motion."""
    instance = swing().start()
    for time in np.linspace(0.013, 0.98, 77):
        instance.step(time - instance.time, until=time)
        exact = SWING.evaluate(time, 6)[:, 0, 0]
        _, velocity, acceleration = instance.get_outputs()
        for order in range(1, END_ORDER + 1):
            found = instance.get_derivatives(order)
            np.testing.assert_allclose(found, exact[order : order + 3], atol=2e-7 * 9.0 ** (order + 2), rtol=0.0)
            if order == 1:
                assert found[:2] == [velocity, acceleration]
            if order == 2:
                assert found[0] == acceleration


def test_standstill_outside_the_motion(swing: Callable[..., Instance]) -> None:
    """Before the motion it waits at the start, after it at the end, with all derivatives zero."""
    instance = swing()
    times = [-0.4, -1e-3, 0.0, 1e-3, 1.0, 1.001, 50.0]
    found = follow(instance, times, start=-0.5)
    for limit, side in ((LEFT, "left"), (RIGHT, "right")):
        np.testing.assert_allclose(found[limit][..., 0], SWING.evaluate(times, 2, side)[..., 0].T, rtol=0.0, atol=1e-12)
    assert instance.get_derivatives(1) == [0.0, 0.0, 0.0]


def test_state_is_saved_and_reset(swing: Callable[..., Instance]) -> None:
    """Time and limit are all there is; they go back and elsewhere like any state."""
    one, two = swing("one").start(), swing("two").start()
    one.step(0.4)
    choose(one, RIGHT)
    before = one.get_outputs()
    state = one.call("getFMUstate")
    data = one.call("serializeFMUstate", state)
    choose(one, LEFT)
    one.step(0.3)
    one.call("setFMUstate", state)
    two.call("setFMUstate", two.call("deSerializeFMUstate", data))
    assert one.get_outputs() == two.get_outputs() == before
    assert one.call("getInteger", [0]) == [RIGHT]
    one.call("freeFMUstate", state)
    one.call("reset")
    one.start()
    assert one.call("getInteger", [0]) == [LEFT]
    assert one.get_outputs() == [0.0, 0.0, 0.0]


def test_bad_calls_are_refused_with_a_sentence(swing: Callable[..., Instance]) -> None:
    """What was wrong, and what would be right."""
    instance = swing().start()
    for call, sentence in {
        lambda: instance.set("axis.reference.velocity", 1.0): "axis.reference.velocity is an output, it cannot be set",
        lambda: instance.call("getReal", [3]): "value reference 3 of a real variable is unknown; there are 3",
        lambda: instance.call("setReal", [7], [1.0]): "value reference 7 of a real variable is unknown; there are 3",
        lambda: choose(instance, 3): "limit must be 1 [(]left[)] or 2 [(]right[)], got 3",
        lambda: instance.call("getInteger", [1]): "value reference 1 of an integer variable is unknown; there are 1",
        lambda: instance.get_derivatives(5): "derivatives of axis.reference.position are of order 1 to 4, got order 5",
        lambda: instance.set_derivatives("axis.reference.position", [1.0]): "value reference 0 is no input",
        lambda: instance.call("doStep", 0.1, 0.1): "communication point must be the present time",
    }.items():
        with pytest.raises(RefusedError, match=sentence):
            call()


def test_motions_that_make_no_table() -> None:
    """Polynomials across a kink would never be good; and one name for each component, each another, with a unit that is known."""
    with pytest.raises(ModelError, match=r"no table reproduces the trajectory at 0[.]4"):
        tabulate(Swing(names_kink=False))  # type: ignore[arg-type]
    for arguments, sentence in {
        (SWING,): "has 1 components, got the axes joint1, joint2",
        (SWING, ("axis",), "furlong"): "unit 'furlong",
        (lame(bang_bang()), ("a", "a")): "more than once",
    }.items():
        with pytest.raises(ModelError, match=sentence):
            build_fmu(Motion(*arguments))


def test_tables_stay_small() -> None:
    """Knots lie where they are needed: the paper's motions take about a hundred."""
    for make in ROBOT.values():
        assert len(tabulate(make()).times) < 200
