"""`run.metrics`: numbers with units and errors, as `measure_run` has them."""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Callable
from copy import copy, deepcopy
from dataclasses import replace
from unittest.mock import Mock

import pandas
import pytest

from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.experiment.scene_run import Companion, Run
from flexfmu.cosim.metrics.metric_table import COMMON_METRICS, metric
from flexfmu.cosim.metrics.metrics import measure_run

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
    assert " ± 1e-" in repr(run.metrics)
    assert make_run().metrics.peak_torque_1.error is None


def test_a_metric_is_a_number(run: Run) -> None:
    """It calculates, is formatted and written like the float that it is; `repr` alone has error and unit."""
    number = metric("peak_torque_1", 2.5, error=0.1)
    assert (number * 2, number == 2.5, f"{number:.2f} {number}", json.dumps(number)) == (5.0, True, "2.50 2.5", "2.5")
    assert repr(number) == "2 ± 1 N·m"
    assert repr(number.changed(error=None)) == "2.5 N·m"
    assert number._repr_html_() == "Peak torque, joint 1 (<code>peak_torque_1</code>): 2 ± 1 N·m"
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
