"""Torque, speed, power and energy of the motors against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
import pytest

from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.metrics.metric_table import DRIVE_METRICS
from flexfmu.cosim.metrics.metrics import Settings, measure
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


def measured(
    torque: Signal, speed: Signal | None, cycles: int = 1, steps: int = 500, names: Iterable[str] = DRIVE_METRICS
) -> dict[str, Metric]:
    """The drive metrics of joint 1, by name without the number, over one second; the motion ends in the middle, a dwell follows."""
    time = np.linspace(0.0, 1.0, steps + 1)
    # robots driven by torques have speeds of their own, others those of the reference
    kind = "velocity" if steps < 500 else "reference.velocity"
    signals = {"torque": torque} | ({} if speed is None else {kind: speed})
    columns = {f"joint1.{name}": Column("", *(each(time, k) for k in range(3))) for name, each in signals.items()}
    task: Trajectory = Motion()  # type: ignore[assignment]
    settings = Settings(task, lambda: np.zeros(2), 0.5, 1e-5, None, cycles)
    wanted = [name for name in names if name.endswith("_1")]
    return {name[:-2]: each for name, each in measure(Recording(time, columns), settings, wanted).items()}


@pytest.mark.parametrize("phase", [0.0, 0.7, math.pi / 2, math.pi])
def test_power_of_two_sines(phase: float) -> None:
    """Torque and speed with a phase between them: active power cos(phase)/2, and a swing of twice the frequency about it.
    Without speeds there are torques alone."""
    found = measured(sine(3.0), sine(2.0, phase))
    for name, amplitude in (("rms_torque", 3.0), ("rms_speed", 2.0)):
        assert found[name] == pytest.approx(amplitude / math.sqrt(2.0), rel=1e-10)
    assert found["peak_speed"] == pytest.approx(2.0, rel=1e-10)
    alone = measured(sine(3.0), None, names=["rms_torque_1", "mean_power_1"])
    assert (alone["rms_torque"], alone["mean_power"].value) == (found["rms_torque"], None)
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
    """Interpolation errors cover the difference from the closed form at ten steps a period, and are of its size."""
    phase = 1.5
    mean = 3.0 * math.cos(phase)
    positive = (mean * (math.pi - phase) + 3.0 * math.sin(phase)) / math.pi
    exact = {"peak_power": 3.0 + mean, "positive_energy": positive, "regenerated_energy": positive - mean}
    found = measured(sine(3.0), sine(2.0, phase), steps=10, names=[f"{name}_1" for name in exact])
    for name, value in exact.items():
        each = found[name]
        assert each.value is not None
        assert 0.3 * each.interpolation_error < abs(each.value - value) <= each.interpolation_error < 1e-2


@pytest.mark.parametrize("cycles", [1, 4])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_errors_of_one_sign_add_up(sign: float, cycles: int) -> None:
    """A power that grows as exp(3 t) has sixth derivatives of one sign, so that errors don't cancel: those of energies and
    means are covered, and at most twice too large, whatever the direction of the power and the number of cycles."""
    energy = 2.0 * (math.exp(3.0) - 1.0) / 3.0
    one_way, other_way = ("positive_energy", "regenerated_energy")[:: int(sign)]
    exact = {"mean_power": sign * energy, "net_energy": sign * energy / cycles, one_way: energy / cycles}
    growing: Signal = lambda t, k: np.asarray(sign * 3.0**k * np.exp(3.0 * t))  # noqa: E731
    found = measured(growing, line(2.0, 0.0), cycles, 4, [f"{name}_1" for name in (*exact, other_way)])
    for name, value in exact.items():
        each = found[name]
        assert each.value is not None
        assert 0.5 * each.interpolation_error < abs(each.value - value) <= each.interpolation_error < 1e-3, name
    assert found[other_way].value == 0.0
