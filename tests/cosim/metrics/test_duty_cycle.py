"""Torque, speed, power and energy of the motors against closed forms; `run.metrics`, and tracking errors cycle by cycle."""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Callable, Iterable
from copy import copy, deepcopy
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pandas
import pytest

from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.cycles import repeated
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.cosim.experiment.scene_run import Companion, Run
from flexfmu.cosim.metrics.metric_table import COMMON_METRICS, DRIVE_METRICS, metric
from flexfmu.cosim.metrics.metrics import Settings, measure, measure_run
from flexfmu.cosim.metrics.signals import cycle_errors
from flexfmu.model.scene.file import load_scene
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


MakeRun = Callable[..., Run]


@pytest.fixture
def run(make_run: MakeRun) -> Run:
    """A run with a companion of half its step, which counts how often it is simulated."""
    return replace(make_run(), companion=Companion(5e-4, 1e-8, lambda progress: make_run(step=5e-4)))


def test_values_and_errors_are_those_of_measure_run(run: Run, make_run: MakeRun) -> None:
    """Attributes and items are the run's own numbers, with the units of the table and their errors by one companion. Without a
    value they are NaN; a failed run says why."""
    for name, measured in measure_run(run).items():
        number = getattr(run.metrics, name)
        assert number == run.metrics[name] == measured.own
        assert (number.unit, number.error) == (COMMON_METRICS[name].unit, measured.own_error)
    failed = make_run(outcome=Outcome.STEP_FAILED, end=0.2).metrics.peak_torque_1
    assert math.isnan(failed)
    assert repr(failed) == "– N·m (step failed at 0.2 s)"


def test_one_metric_is_computed_alone(make_run: MakeRun) -> None:
    """One doesn't wait for all others, and is computed once."""
    measure = Mock(side_effect=measure_run)
    run = replace(make_run(), measure=measure)
    first = run.metrics.peak_torque_1
    assert run.metrics["peak_torque_1"] is first
    assert dict(run.metrics)["peak_torque_1"] is first
    assert [call.args[-1] for call in measure.call_args_list] == [["peak_torque_1"], None]


def test_errors_are_estimated_only_when_asked_for(make_run: MakeRun) -> None:
    """Values cost no simulation; the first error costs one for all."""
    again = Mock(return_value=make_run(step=5e-4))
    run = replace(make_run(), companion=Companion(5e-4, 1e-8, again))
    assert run.metrics.peak_torque_1 > 0.0
    assert "peak_torque_1" in str(run.metrics)
    assert not again.called
    assert all(number.error is not None for number in run.metrics.values())
    assert again.call_count == 1
    assert "e-7 N·m" in repr(run.metrics)
    assert make_run().metrics.peak_torque_1.error is None


def test_a_metric_is_a_number(run: Run) -> None:
    """It calculates, is formatted and written like the float that it is; `repr` alone has error and unit."""
    number = metric("peak_torque_1", 2.5, error=0.1)
    assert (number * 2, number == 2.5, f"{number:.2f} {number}", json.dumps(number)) == (5.0, True, "2.50 2.5", "2.5")
    assert repr(number) == "2.5 ± 0.1 N·m"
    assert repr(number.changed(error=None)) == "2.5 N·m"
    assert number._repr_html_() == "Peak torque, joint 1 (<code>peak_torque_1</code>): 2.5 ± 0.1 N·m"
    for again in (pickle.loads(pickle.dumps(number)), copy(number), deepcopy(number)):
        assert (again, again.value, again.error) == (2.5, 2.5, 0.1)
        assert (again.unit, again.name, again.label) == ("N.m", "peak_torque_1", "Peak torque, joint 1")
    assert (metric("settling_time", None).value, math.isnan(metric("settling_time", None))) == (None, True)
    assert pandas.DataFrame([run.metrics, run.metrics]).dtypes["peak_torque_1"] == "float64"


def test_names(run: Run) -> None:
    """Completion knows the names, and a misspelt one is told the right one."""
    assert {"peak_torque_1", "settling_time"} <= set(dir(run.metrics))
    with pytest.raises(AttributeError, match="no metric 'peak_torqe_1'; did you mean 'peak_torque_1'"):
        _ = run.metrics.peak_torqe_1
    with pytest.raises(KeyError, match="did you mean 'settling_time'"):
        _ = run.metrics["setling_time"]
    assert not hasattr(run.metrics, "_ipython_display_")


def test_reprs_are_short(run: Run) -> None:
    """At most five lines of at most 80 characters, for all that a run consists of; a notebook shows tables."""
    for shown in (run, run.recording, run.plan, run.scene, run.metrics, measure_run(run), run.metrics.peak_torque_1):
        lines = repr(shown).splitlines()
        assert len(lines) <= 5, lines
        assert max(map(len, lines)) <= 80, lines
    assert len(str(run.metrics).splitlines()) == 1 + len(COMMON_METRICS)
    assert "<td>peak_torque_1</td>" in run._repr_html_()
    assert "<td>joint1.torque</td>" in run._repr_html_()


ERRORS = (1e-3, 2e-4)
"""Of the joints in the first cycle [rad]; each further cycle halves them."""


@pytest.fixture(scope="module")
def motion() -> MotionPlan:
    """Three cycles."""
    return repeated(plan(load_scene("barnard2012-6kg")), 3)


def recorded(motion: MotionPlan, until: float) -> Recording:
    """Joints that lag by a sine with whole waves in each half of a cycle, smaller from cycle to cycle."""
    assert motion.repetition is not None
    period = motion.repetition.period
    time = np.linspace(0.0, until, round(until / period * 4000) + 1)
    wave = np.sin(8.0 * np.pi * time / period) * 0.5 ** np.floor(time / period)
    columns = {}
    for joint, size in enumerate(ERRORS, start=1):
        columns[f"joint{joint}.reference.position"] = Column("rad", 1.0 + time)
        columns[f"joint{joint}.position"] = Column("rad", 1.0 + time - size * wave)
    return Recording(time, columns)


def test_each_cycle_has_its_own_error(motion: MotionPlan) -> None:
    """Root mean square and peak of a sine, halved from cycle to cycle; the last cycle ends with its standstill, which is as
    long as the others, or with the run."""
    found = cycle_errors(motion, recorded(motion, motion.stop_time))
    assert len(found) == 3
    for cycle, each in enumerate(found):
        np.testing.assert_allclose(each.rms, np.array(ERRORS) * 0.5**cycle / np.sqrt(2.0), rtol=2e-3)
        np.testing.assert_allclose(each.largest, np.array(ERRORS) * 0.5**cycle, rtol=1e-5)


def test_cycles_that_were_cut_short_do_not_count(motion: MotionPlan) -> None:
    """A run that failed in its third cycle tells the errors of two, one without joint angles none."""
    assert motion.repetition is not None
    recording = recorded(motion, 2.5 * motion.repetition.period)
    assert len(cycle_errors(motion, recording)) == 2
    assert cycle_errors(motion, recording.only(lambda name: name != "joint2.position")) == ()
    assert cycle_errors(motion.once, recording) == ()
