"""First-order lag against its closed forms; and the delay that any block declares, against how late a ramp comes out of it."""

from __future__ import annotations

from collections.abc import Callable
from math import factorial, sqrt
from typing import Any

import mpmath
import numpy as np
import pytest
from blocks import cascade, context, delay, encoder, high_pass, jitter, lag, sampled
from hypothesis import given, settings
from hypothesis import strategies as st
from python_slave import PythonSlave

from flexfmu import filters
from flexfmu.cosim.control.filters import SecondOrder, biquad, filter_block, lead_lag, low_pass, notch
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable
from flexfmu.model.symbolic import SymbolicBlock


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


H = 2.5e-3
COUNT = 2500
"""Samples, enough for what is drawn below to reach its steady state."""

AT_REST: Any = {"sample_time": H, "initial": (0.0, 0.0)}
Draw = np.random.Generator


def drive(time_constant: float) -> SymbolicBlock:
    """A current loop."""
    loop = {"proportional": 1.0}
    return cascade(loop, loop, {"time_constant": time_constant}, **AT_REST)[2]


def delayed(rng: Draw) -> SymbolicBlock:
    """A delay by any of the interpolations."""
    order = int(rng.integers(1, 6))
    rule = {"kind": "lagrange" if rng.random() < 0.5 else "thiran", "order": order}
    return delay(H * (order + rng.uniform(-0.4, 20.0)), rule, **AT_REST)


def filtered(rng: Draw) -> SymbolicBlock:
    """One or two filters, up to 0.45 times the sampling frequency."""
    frequency, other = rng.uniform(0.02, 0.45, 2) / H
    order = int(rng.integers(1, 9))
    kinds: list[Callable[[], list[SecondOrder]]] = [
        lambda: low_pass(frequency, order),
        lambda: notch(frequency, rng.uniform(0.3, 1.0), rng.uniform(0.0, 0.9)),
        lambda: lead_lag(frequency, other),
        lambda: biquad([2.0, 300.0 * rng.random(), 9e4], [1.0, 500.0, 6e4], frequency if rng.random() < 0.5 else None),
    ]
    chosen = rng.integers(0, len(kinds), rng.integers(1, 3))
    return filter_block(
        filters.notch(frequency=1.0, sample_time=H),
        context("filter"),
        [each for kind in chosen for each in kinds[kind]()],
    )


DRAWN: dict[str, Callable[[Draw], SymbolicBlock]] = {
    "whole delay": lambda rng: delay(H * int(rng.integers(0, 60)), **AT_REST),
    "delay": delayed,
    "lag": lambda rng: lag(H * rng.uniform(0.05, 30.0), **AT_REST),
    "encoder": lambda rng: encoder(1e10, window=int(rng.integers(1, 9)), sample_time=H),
    "current loop": lambda rng: drive(H * rng.uniform(0.05, 30.0)),
    "current loop of zero": lambda rng: drive(0.0),
    "filter": filtered,
    "high-pass": lambda rng: high_pass(frequency=rng.uniform(0.02, 0.45) / H, order=3, sample_time=H),
}


def lateness(block: SymbolicBlock) -> np.ndarray:
    """How late each output is [s], in time (N, outputs): an input that is the time itself comes out as gain · (t - delay).

    An encoder's rate is the time itself where its angle is half of the time squared. Without a gain nothing is late.
    """
    t = H * np.arange(COUNT)
    found = []
    for i, each in enumerate(block.outputs):
        y = sampled(block, 0.5 * t**2 if each.name.endswith("velocity") else t)[:, i]
        gain = np.diff(y)[-COUNT // 5 :].mean() / H
        found.append(t - y / gain if abs(gain) > 1e-9 else 0.0 * t)
    return np.array(found).T


@pytest.mark.parametrize("kind", DRAWN)
def test_a_declared_latency_is_that_of_a_ramp(kind: str) -> None:
    """The list of delays adds it up to the dead time of a loop; a lead isn't declared."""
    for seed in range(1 if "zero" in kind else 12 if kind == "filter" else 4):
        block = DRAWN[kind](np.random.default_rng(seed))
        late = lateness(block)[-COUNT // 5 :].mean(axis=0)
        declared = [block.latency.get(each.name, 0.0) for each in block.outputs]
        np.testing.assert_allclose(declared, np.maximum(late, 0.0), rtol=0.0, atol=1e-4 * H, err_msg=block.description)


@pytest.mark.parametrize("largest", [0.3, 1.0])
def test_jitter_declares_its_mean(largest: float) -> None:
    """Within six standard deviations of the mean of what was drawn."""
    block = jitter(largest * H, 1, signal="torque", **AT_REST)
    t = H * np.arange(COUNT)
    late = (t - sampled(block, t)[:, 0])[1:]
    declared = block.latency.get("joint1.torque", 0.0)
    assert abs(late.mean() - declared) <= 6.0 * largest * H / sqrt(12 * len(late)) + 1e-12


def test_a_continuous_lag_declares_how_late_a_ramp_is() -> None:
    """Of each channel, and after its time constant was set."""
    slave = lag(2e-3, initial=(0.0, 0.0))
    slave.set(np.array([3]), np.array([4e-3]))
    slave.initialize(0.0, 1.0, None)
    slave.set(np.arange(2), np.zeros(2))
    slave.set_derivatives(np.arange(2), np.ones((1, 2)))
    y = np.empty(2)
    slave.step(0.0, 1.0)
    slave.get(np.array([4, 5]), y)
    np.testing.assert_allclose([slave.latency[f"joint{k}.torque"] for k in (1, 2)], 1.0 - y, rtol=1e-9)
