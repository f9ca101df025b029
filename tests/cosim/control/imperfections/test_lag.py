"""First-order lag against its closed forms."""

from __future__ import annotations

from math import factorial
from typing import Any

import mpmath
import numpy as np
import pytest
from blocks import lag, sampled
from hypothesis import given, settings
from hypothesis import strategies as st
from python_slave import PythonSlave

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable


def test_time_constants_are_parameters_and_zero_is_one_sample_of_delay() -> None:
    """Each channel has its own time constant; the limit T = 0 is finite."""
    block = lag(1e-3, sample_time=1e-3, initial=(1.0, 1.0))
    u = np.outer([3.0, -2.0, 5.0, 0.0], [1.0, 1.0])
    y = sampled(block, u, {"joint1.torque.time_constant": 0.0})
    np.testing.assert_array_equal(y[:, 0], [1.0, 3.0, -2.0, 5.0])
    np.testing.assert_array_equal(sampled(block, u, {"joint2.torque.time_constant": 0.0})[:, 1], y[:, 0])
    assert y[1, 1] == 3.0 + np.exp(-1.0) * (1.0 - 3.0)


@settings(max_examples=40)
@given(ratio=st.floats(1e-4, 30.0), seed=st.integers(0, 1000), first=st.sampled_from([1.0, 0.25]))
def test_continuous_lag_is_exact_for_polynomials(ratio: float, seed: int, first: float) -> None:
    """A step over any part or multiple of the time constant, or two through which the polynomial goes on, give the closed form,
    evaluated to 40 digits."""
    h, u = 0.5, np.random.default_rng(seed).normal(size=6)
    slave, y = lag(h / ratio, initial=(2.0, 2.0)), np.empty(1)
    slave.initialize(0.0, 1.0, None)
    slave.set(np.array([0]), u[:1])
    slave.set_derivatives(np.array([0]), u[1:, None])
    slave.step(0.0, first * h)
    if first < 1.0:
        slave.step(first * h, (1.0 - first) * h)
    slave.get(np.array([4]), y)
    with mpmath.workdps(40):
        time, end = mpmath.mpf(h / ratio), mpmath.mpf(h)

        def particular(t: Any) -> Any:
            """The polynomial that solves T p' + p = u: the sum of (-T)^k times the k-th derivative of u."""
            return sum(
                (-time) ** k * mpmath.mpf(u[j]) * t ** (j - k) / mpmath.factorial(j - k)
                for j in range(6)
                for k in range(j + 1)
            )

        exact = float(particular(end) + (2 - particular(mpmath.mpf(0))) * mpmath.exp(-end / time))
    assert y[0] == pytest.approx(exact, rel=0.0, abs=1e-15 * (2.0 + abs(u).max()))


class Staircase(PythonSlave):
    """A controller at 1 kHz that puts out random torques."""

    name, sample_time, count = "controller", 1e-3, 0
    variables = (SlaveVariable("joint1.torque", "output", "N.m"),)
    torques = np.random.default_rng(4).normal(size=41)

    def sample(self, time: float) -> None:
        self.memory[:] = self.torques[self.count]
        self.count += 1


class Inertia(PythonSlave):
    """v' = torque, solved exactly for a polynomial torque; first and second derivative of v are given."""

    name, max_input_order, max_output_order = "inertia", 9, 2
    feedthrough = {"v": ()}  # noqa: RUF012
    variables = (SlaveVariable("v", "output"), SlaveVariable("torque", "input", "N.m", 0.0))

    def set(self, indices: Indices, values: RealArray) -> None:
        self.torque = np.array([values[0], *[0.0] * 9])

    def set_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        self.torque[1 : len(derivatives) + 1] = derivatives[:, 0]

    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        derivatives[:, 0] = self.torque[: len(derivatives)]

    def step(self, time: float, step: float) -> None:
        self.memory[0] += sum(value * step ** (k + 1) / factorial(k + 1) for k, value in enumerate(self.torque))
        self.torque[:] = 0.0


@pytest.mark.parametrize("step", [1e-3, 2e-4, 2.5e-5])
def test_a_short_lag_behind_a_slow_controller(step: float) -> None:
    """Whatever the communication step: at 1 kHz a lag of 0.2 ms acts as one of 0.2 ms, on what the inertia gets and on its
    rates right after the jumps; the list of delays tells the lag and the controller's hold."""
    time_constant = 2e-4
    slaves = [Inertia(), Staircase(), lag(time_constant, initial=(0.0, 0.0))]
    wires = [("controller.joint1.torque", "lag.joint1.torque.input"), ("lag.joint1.torque", "inertia.torque")]
    result = simulate(connect(slaves, wires), 0.04, step)
    assert result.outcome is Outcome.COMPLETED, result.message
    time, v = result.recording.time, result.recording["inertia.v"]
    right = np.append(np.diff(time) > 0.0, True)
    exact_y, exact_v, y, speed = [], [], 0.0, 0.0
    for k, u in enumerate(Staircase.torques):
        since = time[right][(time[right] > (k - 1e-6) * 1e-3) & (time[right] < (k + 1 - 1e-6) * 1e-3)] - k * 1e-3
        exact_y += (u + (y - u) * np.exp(-since / time_constant)).tolist()
        exact_v += (speed + u * since + (y - u) * time_constant * -np.expm1(-since / time_constant)).tolist()
        speed += u * 1e-3 + (y - u) * time_constant * -np.expm1(-5.0)
        y = u + (y - u) * np.exp(-5.0)
    np.testing.assert_allclose(result.recording["lag.joint1.torque"].values[right], exact_y, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(v.values[right], exact_v, rtol=0.0, atol=1e-9 * 1e-3)
    assert [each.average for each in result.delays] == [pytest.approx(5e-4), pytest.approx(time_constant)]
    jumps = abs(time[right] / 1e-3 - np.round(time[right] / 1e-3)) < 1e-6
    slope = (Staircase.torques[:40] - np.array(exact_y)[jumps][:40]) / time_constant
    assert v.second is not None
    np.testing.assert_allclose(v.second[right][jumps][:40], slope, rtol=1e-9)


def test_what_a_continuous_lag_refuses() -> None:
    """No time constant of zero, and none that asks for thousands of steps in one."""
    with pytest.raises(InputError, match=r"time constant of joint1\.torque must be positive, got 0\.0 s"):
        lag(1e-3, initial=(2.0, 2.0)).set(np.array([2]), np.zeros(1))
    with pytest.raises(InputError, match=r"lag needs steps of 1e-08 s, 1e\+05 of them"):
        simulate(connect([lag(1e-8, initial=(2.0, 2.0))], []), 1.0, 1e-3)


def test_a_continuous_lag_leaves_as_a_block() -> None:
    """With ten samples or more in its shortest time constant, a whole number of them in a communication step, and the
    same names."""
    slave = lag(1e-3, initial=(1.0, 2.0))
    slave.set(np.array([2]), np.array([2.3e-4]))
    block = slave.sampled(1e-3)
    samples = 1e-3 / block.sample_time
    assert samples == pytest.approx(round(samples), rel=1e-12)
    assert 2.3e-5 / 2.0 < block.sample_time <= 2.3e-5
    assert [each.name for each in slave.variables if each.causality != "parameter"] == [
        each.name for each in (*block.inputs, *block.outputs)
    ]


def test_bound_calls_are_the_methods() -> None:
    """Bound to buffers, which may be parts of all variables in any order, the calls do what the methods do, bit by bit."""
    rng = np.random.default_rng(4)
    bound, plain = (lag(1e-3, initial=(1.0, -2.0)) for _ in range(2))
    for slave in (bound, plain):
        slave.set(np.array([3]), np.array([3e-4]))
    inputs, outputs = np.array([1, 0]), np.array([5, 4])
    u, y = rng.normal(size=(4, 2)), np.empty((4, 2))
    sends = [bound.bind_set(inputs, u[0]), bound.bind_set_derivatives(inputs, u[1:])]
    reads = [bound.bind_get(outputs, y[0]), bound.bind_get_derivatives(outputs, y[1:])]
    for slave in (bound, plain):
        slave.initialize(0.0, 1.0, None)
    for step in (1e-4, 3e-4):
        u[:] = rng.normal(size=u.shape)
        for call in sends:
            call()
        plain.set(inputs, u[0])
        plain.set_derivatives(inputs, u[1:])
        for slave in (bound, plain):
            slave.step(0.0, step)
        for call in reads:
            call()
        expected = np.empty_like(y)
        plain.get(outputs, expected[0])
        plain.get_derivatives(outputs, expected[1:])
        assert y.tobytes() == expected.tobytes()
    with pytest.raises(InputError, match="only inputs can be connected"):
        bound.bind_set(np.array([2]), np.empty(1))
