"""Metrics on recordings in closed form: a rigid motion plus a vibration whose peaks and means are known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.metrics.metric_table import COMMON_METRICS, METRICS
from flexfmu.cosim.metrics.metrics import Settings, measure, measure_run, measuring

T, DWELL, STEP = 0.4, 0.3, 2e-3
OMEGA = 2 * math.pi * 20.0
Signal = Callable[[RealArray, int], RealArray]
"""(time, order) → time derivative of that order of a smooth signal."""


@dataclass(frozen=True)
class Quadratic:
    """A rigid motion along x: 2 t^2 until T, then standstill at its end point."""

    duration: float = T
    breakpoints: tuple[float, ...] = (0.0, T)

    def evaluate(self, time: RealArray, order: int = 2, side: str = "right") -> RealArray:
        """(order + 1, N, 2) position and derivatives."""
        moving = (time < T) if side == "right" else (time <= T)
        x = np.zeros((order + 1, len(time), 2))
        for k, values in enumerate((2.0 * np.minimum(time, T) ** 2, 4.0 * time * moving, 4.0 * moving)[: order + 1]):
            x[k, :, 0] = values
        return x


def sine(amplitude: float, omega: float, decay: float = 0.0, phase: float = 0.0) -> Signal:
    """amplitude exp(-decay t) sin(omega t + phase), with all derivatives."""
    root = complex(-decay, omega)
    return lambda t, order: np.imag(amplitude * root**order * np.exp(root * t + 1j * phase))


def column(signal: Signal, time: RealArray, order: int = 0) -> Column:
    """The order-th derivative of a signal as a recorded column."""
    return Column("", signal(time, order), signal(time, order + 1), signal(time, order + 2))


def recording(motion: Signal, dwell: Signal, step: float = STEP) -> Recording:
    """A robot that deviates from the rigid one by `motion` in y, then by `dwell` (of the time since T) in y."""
    before = np.linspace(0.0, T, round(T / step) + 1)
    after = np.linspace(0.0, DWELL, round(DWELL / step) + 1)
    time = np.concatenate([before, T + after])
    rigid = Quadratic()
    x = np.hstack([rigid.evaluate(before, 4, "left"), rigid.evaluate(T + after, 4, "right")])[..., 0]
    y = np.stack([np.concatenate([motion(before, k), dwell(after, k)]) for k in range(5)])
    columns: dict[str, Column] = {}
    for axis, d in (("x", x), ("y", y)):
        for order, kind in enumerate(("position", "velocity", "acceleration")):
            columns[f"end_effector.{kind}.{axis}"] = Column("", *d[order : order + 3])
    loads = "joint1.torque joint2.torque link11.tip_deflection link21.tip_deflection link11.bending[1]"
    columns |= dict.fromkeys(loads.split(), column(sine(3.0, OMEGA), time))
    return Recording(time, columns)


def settings(band: float = 1e-5, dwell: float = DWELL) -> Settings:
    """Equilibrium where the rigid motion ends."""
    return Settings(Quadratic(), lambda: np.array([2.0 * T**2, 0.0]), dwell, band)


def value(name: str, run: Recording, **changes: float) -> float:
    """One metric's value, which must exist."""
    found = measure(run, settings(**changes))[name].value
    assert found is not None
    return found


VIBRATION = sine(1e-3, OMEGA, phase=0.2)
RINGING = sine(1e-3, OMEGA, decay=30.0, phase=0.9)


def in_two_parts(motion: Signal, dwell: Signal, time: RealArray, order: int = 0) -> Column:
    """A signal that is another one from the right limit at T on."""
    moving = np.arange(time.size) <= np.searchsorted(time, T)
    return Column("", *(np.where(moving, motion(time, k), dwell(time, k)) for k in range(order, order + 3)))


def test_peaks_are_those_of_the_motion() -> None:
    """Peaks between the communication points count; what a robot's loads are when it has arrived doesn't."""
    run, loads = recording(VIBRATION, RINGING), ("joint1.torque", "link11.bending[1]", "link21.tip_deflection")
    later = in_two_parts(sine(3.0, OMEGA), sine(10.0, OMEGA), run.time)
    louder = run.with_columns(dict.fromkeys(loads, later))
    for name in [
        "peak_torque_1",
        "peak_torque_2",
        "peak_modal_deflection_1",
        "peak_tip_deflection_1",
        "peak_tip_deflection_2",
    ]:
        assert value(name, run) == pytest.approx(3.0, rel=1e-7)
        assert value(name, louder) == pytest.approx(3.0, rel=1e-7)
    assert value("peak_position_error", run) == pytest.approx(1e-3, rel=1e-9)


def test_tracking_errors() -> None:
    """The largest one counts during the dwell too, the root mean square over the motion alone; the plan stands still then."""
    run = recording(VIBRATION, RINGING)
    x = {kind: run[f"end_effector.{kind}.x"] for kind in ("position", "acceleration")}
    motion, dwell, orders = sine(1e-3, OMEGA), sine(4e-3, OMEGA), {"position": 0, "acceleration": 2}
    errors = {kind: in_two_parts(motion, dwell, run.time, order) for kind, order in orders.items()}
    columns = {f"joint2.{kind}": each for kind, each in errors.items()}
    for kind, error in errors.items():
        pairs = zip(
            (x[kind].values, x[kind].first, x[kind].second), (error.values, error.first, error.second), strict=True
        )
        columns[f"joint1.{kind}"] = Column("rad", *(planned + deviation for planned, deviation in pairs))
    found = measure(run.with_columns(columns), replace(settings(), joints=Quadratic()))
    for joint in (1, 2):
        assert found[f"peak_tracking_error_{joint}"].value == pytest.approx(4e-3, rel=1e-7)
        assert found[f"rms_tracking_error_{joint}"].value == pytest.approx(1e-3 / math.sqrt(2.0), rel=1e-7)


def test_root_mean_square_acceleration_error() -> None:
    """The mean square of a sine over whole periods is half its squared amplitude."""
    assert T * OMEGA / (2 * math.pi) == pytest.approx(8.0)
    expected = 1e-3 * OMEGA**2 / math.sqrt(2.0)
    assert value("rms_acceleration_error", recording(VIBRATION, RINGING)) == pytest.approx(expected, rel=1e-7)


def test_end_errors_are_taken_before_the_last_jump() -> None:
    """At t = T the left limits count: the dwell's vibration must not be seen."""
    run = recording(VIBRATION, RINGING)
    end = np.array([T])
    for order, kind in enumerate(("position", "velocity", "acceleration")):
        assert value(f"end_{kind}_error", run) == pytest.approx(abs(VIBRATION(end, order)[0]), rel=1e-9)


def test_jump_counts_on_both_sides() -> None:
    """A torque that jumps from 7 to -9 at a breakpoint peaks at 9; the standstill before t = 0 doesn't count."""
    run = recording(VIBRATION, RINGING)
    middle = int(np.searchsorted(run.time, T / 2))
    rows = np.sort([0, *range(run.time.size), middle])
    torque = np.where(np.arange(rows.size) <= middle + 1, 7.0, -9.0)
    torque[0] = 50.0
    columns = {
        name: Column("", *(each[rows] for each in (c.values, c.first, c.second) if each is not None))
        for name, c in run.columns.items()
    }
    jumping = Recording(run.time[rows], {**columns, "joint1.torque": Column("N.m", torque, 0 * torque, 0 * torque)})
    assert value("peak_torque_1", jumping) == 9.0
    assert measure(jumping, settings())["peak_torque_1"].interpolation_error < 1e-9


def test_residual_vibration_in_closed_form() -> None:
    """Amplitude, RMS and settling time of a damped vibration after the motion."""
    run = recording(VIBRATION, RINGING)
    time = np.linspace(0.0, DWELL, 2_000_001)
    ringing = np.abs(RINGING(time, 0))
    assert value("residual_vibration_amplitude", run) == pytest.approx(ringing.max(), rel=1e-8)
    root = complex(-30.0, OMEGA)
    steady = (math.exp(-60.0 * DWELL) - 1.0) / -60.0
    turning = ((np.exp(2 * root * DWELL) - 1.0) / (2 * root) * np.exp(1.8j)).real
    expected = 1e-3 * math.sqrt((steady - turning) / 2 / DWELL)
    assert value("residual_vibration_rms", run) == pytest.approx(expected, rel=1e-8)
    settled = time[np.flatnonzero(ringing >= 2e-5)[-1]]
    assert value("settling_time", run, band=2e-5) == pytest.approx(settled, abs=3e-7)


def test_settling_at_once_or_never_and_no_dwell() -> None:
    """A band wider than the whole vibration: settled at once. An undamped vibration never settles. Without a dwell there is no residual."""
    assert value("settling_time", recording(VIBRATION, RINGING), band=2e-3) == 0.0
    assert measure(recording(VIBRATION, VIBRATION), settings())["settling_time"].value is None
    found = measure(recording(VIBRATION, RINGING), settings(dwell=0.0))
    names = "residual_vibration_amplitude", "residual_vibration_rms", "settling_time"
    assert [found[name].value for name in names] == [None] * 3


def test_rigid_links_do_not_deflect() -> None:
    """Without bending modes there is no such output, and the deflection is zero."""
    run = recording(VIBRATION, RINGING)
    rigid = Recording(run.time, {name: c for name, c in run.columns.items() if not name.startswith("link")})
    assert value("peak_modal_deflection_1", rigid) == value("peak_tip_deflection_2", rigid) == 0.0


@pytest.mark.parametrize("name", [name for name in METRICS if not name.startswith("end_")])
def test_interpolation_error_is_what_a_coarse_step_costs(name: str) -> None:
    """The reported error covers the true one within a factor of three, at 1 rad of the vibration per step."""
    coarse = measure(recording(VIBRATION, RINGING, step=8e-3), settings())[name]
    fine = value(name, recording(VIBRATION, RINGING, step=5e-4))
    assert coarse.value is not None
    assert abs(coarse.value - fine) < 3.0 * coarse.interpolation_error + 1e-12 * fine
    assert coarse.interpolation_error < 0.05 * fine


def test_unknown_metric_is_told_with_those_that_exist() -> None:
    """Whoever writes `peak_torque` reads `peak_torque_1`; without joints' motions there is no tracking error either."""
    measurements = measure(recording(VIBRATION, RINGING), settings())
    assert "peak_torque" not in measurements
    for name in ("peak_torque", "peak_tracking_error_1"):
        with pytest.raises(KeyError, match=f"no metric '{name}'; there are: {', '.join(COMMON_METRICS)}"):
            measurements[name]
    with pytest.raises(InputError, match=r"peak_tracking_error_1.*driven by torques"):
        measure(recording(VIBRATION, RINGING), settings(), ["peak_tracking_error_1"])


def test_a_failed_run_is_the_reason_why_it_has_no_metrics() -> None:
    """Whatever metric is asked of it, one of a loop too, the answer quotes the run's own message."""
    failed = SimpleNamespace(completed=False, message="plant failed: at 0.1 s the motor came off")
    found = measure_run(failed)  # type: ignore[arg-type]
    assert (found["peak_torque_1"].value, found["peak_torque_1"].reason) == (None, failed.message)
    with pytest.raises(KeyError, match=r"the run failed: plant failed: at 0\.1 s the motor came off"):
        found["peak_tracking_error_1"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (None, r"the signal `joint2\.torque`"),
        ({"first": None}, r"derivatives of `joint2\.torque`"),
        ({"values": np.where(np.arange(352) == 17, np.nan, 1.0)}, r"metric `peak_torque_2` is nan"),
    ],
)
def test_missing_and_spoiled_signals_are_named(changes: dict[str, Any] | None, message: str) -> None:
    """An incomplete recording is refused by the name of the signal, a NaN by that of the metric, which isn't null."""
    run = recording(VIBRATION, RINGING)
    columns = {name: each for name, each in run.columns.items() if name != "joint2.torque"}
    columns |= {} if changes is None else {"joint2.torque": replace(run["joint2.torque"], **changes)}
    with pytest.raises(ResultsError, match=message):
        measure(Recording(run.time, columns), settings())


def test_only_the_metrics_that_are_asked_for() -> None:
    """Their values are those among all metrics, in the order of the table; signals and equilibrium of others aren't needed."""
    run = recording(VIBRATION, RINGING)
    everything = measure(run, settings())
    names = ["settling_time", "peak_torque_1", "rms_acceleration_error"]
    some = measure(run, settings(), names)
    assert list(some) == sorted(names, key=list(METRICS).index)
    assert all(some[name] == everything[name] for name in names)

    def fail() -> RealArray:
        raise AssertionError("no metric of the motion needs the equilibrium")

    alone = Recording(run.time, {"joint1.torque": run["joint1.torque"]})
    without = replace(settings(), rest=fail)
    assert measure(alone, without, ["peak_torque_1"])["peak_torque_1"] == everything["peak_torque_1"]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["peak_torqe_1"], r"there is no metric 'peak_torqe_1'; did you mean 'peak_torque_1'\?"),
        ("peak_torque_1", "a list of names, got the single text 'peak_torque_1'"),
    ],
)
def test_unknown_metrics_are_refused_before_anything_is_simulated(names: list[str], message: str) -> None:
    """A sweep fails at once, and so does a run, even a failed one."""
    with pytest.raises(InputError, match=message):
        measuring(names)
    failed = SimpleNamespace(completed=False, message="the motor came off")
    with pytest.raises(InputError, match=message):
        measure_run(failed, names=names)  # type: ignore[arg-type]
