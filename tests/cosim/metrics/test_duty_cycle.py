"""Torque, speed, power and energy of the motors against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.metrics.metric_table import DRIVE_METRICS
from flexfmu.cosim.metrics.metrics import measure
from flexfmu.cosim.metrics.recorded_solution import Settings
from flexfmu.trajectories.trajectory import Trajectory

OMEGA = 2.0 * math.pi
"""One period in a second."""

Signal = Callable[[RealArray, int], RealArray]
"""Time and order of the derivative → values."""


def sine(amplitude: float, phase: float = 0.0) -> Signal:
    """Sine of one period in a second."""
    return lambda t, k: amplitude * OMEGA**k * np.sin(OMEGA * t + phase + 0.5 * math.pi * k)


def line(start: float, slope: float) -> Signal:
    """Straight line."""
    return lambda t, k: start + slope * t if k == 0 else np.full_like(t, slope if k == 1 else 0.0)


class Motion:
    """A rigid robot's motion, as far as a metric of the motors asks for it."""

    duration = 0.5


def measured(torque: Signal, speed: Signal, cycles: int = 1, steps: int = 500, end: float = 1.0) -> dict[str, float]:
    """The drive metrics of joint 1, by name without the number; the motion ends in the middle, a dwell follows."""
    time = np.linspace(0.0, end, steps + 1)

    def column(signal: Signal) -> Column:
        return Column("", *(signal(time, k) for k in range(3)))

    names = {"torque": torque, "reference.velocity": speed}
    columns = {f"joint1.{name}": column(signal) for name, signal in names.items()}
    task: Trajectory = Motion()  # type: ignore[assignment]
    settings = Settings(task, lambda: np.zeros(2), end, 1e-5, None, cycles)
    wanted = [name for name in DRIVE_METRICS if name.endswith("_1")]
    found = {name[:-2]: each.value for name, each in measure(Recording(time, columns), settings, wanted).items()}
    return {name: value for name, value in found.items() if value is not None}


def test_sine_torque() -> None:
    """RMS of a sine is its amplitude by the root of two, over motion and dwell together."""
    found = measured(sine(3.0), sine(2.0, 0.3))
    assert found["rms_torque"] == pytest.approx(3.0 / math.sqrt(2.0), rel=1e-10)
    assert found["rms_speed"] == pytest.approx(2.0 / math.sqrt(2.0), rel=1e-10)
    assert found["peak_speed"] == pytest.approx(2.0, rel=1e-10)


@pytest.mark.parametrize("phase", [0.0, 0.7, math.pi / 2, math.pi])
def test_power_of_two_sines(phase: float) -> None:
    """Torque and speed with a phase between them: active power cos(phase)/2, and a swing of twice the frequency about it."""
    found = measured(sine(3.0), sine(2.0, phase))
    mean, swing = 3.0 * math.cos(phase), 3.0
    # where cos(x) = -cos(phase) the power mean - swing cos(x) changes its sign
    positive = (mean * (math.pi - phase) + swing * math.sin(phase)) / math.pi
    assert found["mean_power"] == pytest.approx(mean, rel=1e-9, abs=1e-9)
    assert found["net_energy"] == pytest.approx(mean, rel=1e-9, abs=1e-9)
    assert found["peak_power"] == pytest.approx(swing + mean, rel=1e-9, abs=1e-7)
    assert found["peak_regenerated_power"] == pytest.approx(swing - mean, rel=1e-9, abs=1e-7)
    assert found["positive_energy"] == pytest.approx(positive, rel=1e-7, abs=1e-8)
    assert found["positive_energy"] - found["regenerated_energy"] == pytest.approx(found["net_energy"], abs=1e-12)


def test_constant_power() -> None:
    """A motion whose torque falls as 1/speed: 20 W throughout, nothing is regenerated."""

    def torque(t: RealArray, k: int) -> RealArray:
        return np.asarray(20.0 * (-1.0) ** k * math.factorial(k) / (1.0 + t) ** (k + 1))

    found = measured(torque, line(1.0, 1.0), cycles=4)
    assert found["peak_power"] == pytest.approx(20.0, rel=1e-10)
    assert found["mean_power"] == pytest.approx(20.0, rel=1e-10)
    assert found["positive_energy"] == pytest.approx(20.0 / 4, rel=1e-10)
    assert found["regenerated_energy"] == found["peak_regenerated_power"] == 0.0


def test_a_coarse_step_has_an_error() -> None:
    """Interpolation errors cover the difference from the closed form at ten steps a period."""
    time = np.linspace(0.0, 1.0, 11)
    signals = {"joint1.torque": sine(3.0), "joint1.velocity": sine(2.0, 0.7)}
    columns = {name: Column("", *(signal(time, k) for k in range(3))) for name, signal in signals.items()}
    task: Trajectory = Motion()  # type: ignore[assignment]
    mean = 3.0 * math.cos(0.7)
    positive = (mean * (math.pi - 0.7) + 3.0 * math.sin(0.7)) / math.pi
    exact = {"peak_power_1": 3.0 + mean, "positive_energy_1": positive}
    found = measure(Recording(time, columns), Settings(task, lambda: np.zeros(2), 0.5, 1e-5), list(exact))
    for name, value in exact.items():
        each = found[name]
        assert each.value is not None
        assert 1e-9 < abs(each.value - value) <= each.interpolation_error < 1e-2


def test_a_robot_without_known_speeds() -> None:
    """Without speeds there are torques alone."""
    time = np.linspace(0.0, 1.0, 101)
    columns = {"joint1.torque": Column("N.m", *(sine(3.0)(time, k) for k in range(3)))}
    task: Trajectory = Motion()  # type: ignore[assignment]
    found = measure(
        Recording(time, columns), Settings(task, lambda: np.zeros(2), 0.5, 1e-5), ["rms_torque_1", "mean_power_1"]
    )
    assert found["rms_torque_1"].value == pytest.approx(3.0 / math.sqrt(2.0))
    assert found["mean_power_1"].value is None
