"""PD and PID: closed forms and anti-windup."""

from __future__ import annotations

import control
import numpy as np
import pytest
from blocks import pd, pid, responses
from numpy.typing import NDArray

from flexfmu.cosim.control.blocks.slave import BlockSlave

Array = NDArray[np.float64]

H = 1e-3


TIME = H * np.arange(400)


def test_pd_is_its_formula() -> None:
    """Every joint has its own gains, errors and feedforward."""
    rng = np.random.default_rng(0)
    model = pd([50.0, 70.0], [2.0, 3.0], sample_time=H)
    signals = {variable.name: rng.normal(size=20) for variable in model.inputs}
    torque = responses(model, signals)
    for joint, k_p, k_d in (("joint1", 50.0, 2.0), ("joint2", 70.0, 3.0)):
        expected = (
            k_p * (signals[f"{joint}.reference.position"] - signals[f"{joint}.position"])
            + k_d * (signals[f"{joint}.reference.velocity"] - signals[f"{joint}.velocity"])
            + signals[f"{joint}.feedforward"]
        )
        np.testing.assert_allclose(torque[f"{joint}.torque"], expected, rtol=1e-14, atol=1e-13)


@pytest.mark.parametrize("filter_time", [0.0, 5e-4, 8e-3])
def test_pid_is_its_transfer_function(filter_time: float) -> None:
    """The triangle-hold equivalent of I and filtered D, against `control.forced_response`, to rounding."""
    k_p, k_i, k_d = 40.0, 300.0, 2.0
    a = np.exp(-H / filter_time) if filter_time else 0.0
    integral = control.tf([k_i * H / 2.0, k_i * H / 2.0], [1.0, -1.0], H)
    derivative = control.tf([k_d * (1.0 - a) / H, -k_d * (1.0 - a) / H], [1.0, -a], H)
    error = np.random.default_rng(2).normal(size=TIME.size)
    error[0] = 0.0
    model = pid(k_p, k_i, k_d, sample_time=H, filter_time=filter_time)
    found = responses(model, {"joint1.reference.position": error})["joint1.torque"]
    parts = [control.forced_response(each, TIME, error).outputs for each in (integral, derivative)]
    np.testing.assert_allclose(found, k_p * error + parts[0] + parts[1], rtol=1e-12, atol=1e-12 * abs(found).max())


def test_first_samples_and_weights() -> None:
    """A start away from the reference gives the proportional torque and the initial one, no derivative impulse; with setpoint and
    derivative weight zero a jump of the reference moves the integral alone."""
    for weight in (1.0, 0.0):
        model = pid(10.0, 5.0, 3.0, sample_time=H, initial_torque=2.0, setpoint_weight=weight)
        torque = responses(model, {"joint1.reference.position": [1.0, 1.0]})["joint1.torque"]
        np.testing.assert_allclose(torque, [12.0, 12.0 + 5.0 * H], rtol=1e-14)
    model = pid(10.0, 5.0, 3.0, sample_time=H, setpoint_weight=0.0, derivative_weight=0.0)
    torque = responses(model, {"joint1.reference.position": [0.0, 1.0, 1.0]})["joint1.torque"]
    np.testing.assert_allclose(torque, [0.0, 2.5 * H, 7.5 * H], rtol=1e-14, atol=1e-17)


def test_weights_know_no_origin_of_angles() -> None:
    """Angles that count from elsewhere change no torque, and at the reference the first one is the initial one: drawn laws."""
    rng = np.random.default_rng(4)
    rules = ("clamping", {"kind": "back-calculation", "tracking_time": 0.01}, "none")
    for case in range(30):
        law = {
            "setpoint_weight": rng.choice([0.0, rng.uniform(0.0, 1.5)]),
            "filter_time": rng.choice([0.0, 2e-3]),
            "torque_limit": 40.0 if case % 2 else None,
            "anti_windup": rules[case % 3],
            "initial_torque": rng.uniform(-30.0, 30.0),
            "schedule": {"over": "load", "at": [0.0, 1.0], "proportional": [0.5, 1.0]} if case % 5 == 0 else None,
        }
        model = pid(rng.uniform(1.0, 1e3), rng.uniform(0.0, 1e3), rng.uniform(0.0, 5.0), sample_time=H, **law)
        angles = rng.normal(scale=0.02, size=(2, 20)).cumsum(axis=1)
        angles[:, 0] = 0.0
        near, far = (
            responses(model, {"joint1.reference.position": angles[0] + origin, "joint1.position": angles[1] + origin})
            for origin in (0.0, rng.uniform(-4.0, 4.0))
        )
        assert far["joint1.torque"][0] == pytest.approx(law["initial_torque"], abs=1e-9)
        # where a torque is exactly at its limit, rounding decides whether the integral moves
        np.testing.assert_allclose(far["joint1.torque"], near["joint1.torque"], rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("tracking_time", [0.02, 0.0])
def test_back_calculation_is_exact(tracking_time: float) -> None:
    """With a constant error the excess over the limit follows its differential equation's held solution."""
    k_i, a = 10.0, np.exp(-H / tracking_time) if tracking_time else 0.0
    rule = {"kind": "back-calculation", "tracking_time": tracking_time}
    slave = BlockSlave(pid(5.0, k_i, 0.0, sample_time=H, torque_limit=1.0, anti_windup=rule))
    slave.initialize(0.0, 1.0, None)
    slave.set(np.array([0]), np.array([1.0]))
    carried = 0.0
    for k in range(200):
        slave.sample(k * H)
        now = 4.0 + carried + (k_i * H if k else 0.0)
        carried = a * now - 4.0
        assert 5.0 + slave.save()[-18:][1] - 1.0 == pytest.approx(a * now, rel=1e-12, abs=1e-14)
    assert a * now == pytest.approx(k_i * H * a / (1.0 - a), rel=1e-3)
