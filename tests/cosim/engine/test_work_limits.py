"""Work without end is told: by the master, by the FMU, and before long runs."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.cli.console import one_line_errors
from flexfmu.cosim.engine.errors import CostWarning, InputError
from flexfmu.cosim.engine.master import simulator, step_control
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.master.simulator import simulate
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.model.scene.file import load_scene

Factory = Callable[..., Any]


def test_step_control_gives_up(split_oscillator: Factory, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tolerance that takes far more steps than the first one's length would ends the run where it is, with the numbers
    and the remedy; the limit grows with the run's length."""
    monkeypatch.setattr(step_control, "WORK_AT_START", 10.0)
    monkeypatch.setattr(step_control, "WORK", 2.0)
    for stop in (1.0, 2.0):
        result = simulate(split_oscillator(0).system(), stop, 0.02, step_control=StepDoubling(tolerance=1e-5))
        assert result.outcome is Outcome.TOO_MUCH_WORK
        assert "take a larger tolerance" in result.message
        assert 10 + 100 * stop < result.steps + result.rejected <= 12 + 100 * stop
        assert 0.0 < result.recording.time[-1] < stop


@pytest.mark.slow
def test_friction_that_hardly_slides_ends() -> None:
    """Coulomb friction with a velocity of 1e-6 rad/s, which took 31 million evaluations for 0.43 s, ends after fewer than
    40 million a second, with the remedy; at 1e-4 rad/s, hard but honest, it reaches its end."""
    scene = load_scene("barnard2012-0.1kg").replace(
        {
            "cosimulation.drive": "torque",
            "cosimulation.step": 1e-3,
            "effects.motor_inertia": 0.01,
            "controller": [{"kind": "pd", "proportional": 1e3, "derivative": 10.0, "sample_time": 1e-3}],
            "trajectory.dwell": 0.13,
        }
    )
    friction = {"viscous": 0.0, "coulomb": 2.0}
    honest = run_scene(scene.replace({"effects.joint_friction": friction | {"velocity": 1e-4}}))
    assert honest.outcome is Outcome.COMPLETED, honest.message
    endless = run_scene(scene.replace({"effects.joint_friction": friction | {"velocity": 1e-6}}))
    assert endless.outcome is Outcome.STEP_FAILED
    assert "more than 4e+07 times per second of motion" in endless.message
    assert 'let it stick (`effects.joint_friction.kind` = "stiction")' in endless.message
    assert endless.health.statistics["evaluations"] < 1e6 + 1e3 * 430 + 4e7 * 0.43


def test_long_runs_are_announced(split_oscillator: Factory, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that records very much says so with its numbers and the remedy; a smaller one doesn't."""
    monkeypatch.setattr(simulator, "MANY_VALUES", 10**4)
    system = split_oscillator(0).system()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulate(system, 2.0, 2.0 / 2000)
    said = r"makes 5e\+03 communication steps and records 2e\+04 values, 0.00016 GB of memory or temporary files"
    with pytest.warns(CostWarning, match=said) as told:
        simulate(system, 2.0, 2.0 / 5000)
    assert len(told) == 1
    assert "take a larger communication step" in str(told[0].message)
    monkeypatch.setattr(simulator, "MANY_VALUES", 10**8)
    monkeypatch.setattr(simulator, "MANY_POINTS", 3000)
    with pytest.warns(CostWarning):
        simulate(system, 2.0, 2.0 / 5000)


def test_the_command_line_announces_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """On standard error, without the line of code."""
    with one_line_errors():
        warnings.simplefilter("default")
        warnings.warn("long", CostWarning, stacklevel=1)
    assert capsys.readouterr().err == "flexfmu: warning: long\n"


def test_a_recording_beyond_memory_is_refused(split_oscillator: Factory) -> None:
    """With its size and the remedy, before anything runs."""
    system = split_oscillator(0).system()
    port: Any = SimpleNamespace(slave=system.slaves[0], recorded=1, indices=np.arange(2), signals=np.zeros((1, 2)))
    said = r"2e\+16 values at 1e\+16 instants are 1.6e\+08 GB, more than there is; take a"
    with pytest.raises(InputError, match=said):
        Recorder([port], 10**16)
