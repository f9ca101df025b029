"""A coupling that blows up is told apart from a system that moves fast, grows or resonates; and work without end is told."""

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
from flexfmu.cosim.engine.master.outcome import Outcome, find_alternation, find_instability
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.master.simulator import simulate
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.model.scene.file import load_scene

TIME = 0.01 * np.arange(400)


STEADY = (-1.0) ** np.arange(400)


@pytest.mark.parametrize(("multiplier", "growth"), [(-1.5, 1.5), (-20.0, 20.0), (1.3 * np.exp(1.2j), 1.3), (2.0, 2.0)])
@pytest.mark.parametrize("sides", [1, 2])
def test_growth_from_step_to_step(multiplier: complex, growth: float, sides: int) -> None:
    """Signals multiplied by a number beyond one in every step, alternating, turning or growing, are found, the fastest
    first; of points that appear twice the right limit counts."""
    count = 200 if abs(multiplier) < 10.0 else 100
    values = (np.power(complex(multiplier), np.arange(count))).real
    time = np.repeat(TIME[:count], sides)
    found = find_instability(time, [("calm", np.sin(time)), ("a.y", np.repeat(values, sides))])
    assert found is not None
    assert found.signal == "a.y"
    assert found.growth == pytest.approx(growth, rel=0.15)
    assert found.since < 0.3


@pytest.mark.parametrize("count", [7, 40])
def test_overshoot_from_step_to_step(count: int) -> None:
    """A loop that overshoots three times as far in every step is found after a few steps, also where a mechanism at its end
    takes the growth away."""
    values = np.concatenate([[0.0, 0.0], (-3.0) ** np.arange(count), [5.0, 4.0]])
    found = find_alternation(TIME[: values.size], [("calm", np.sin(TIME[: values.size])), ("pd.torque", values)])
    assert found is not None
    assert found.signal == "pd.torque"
    assert found.growth == pytest.approx(3.0, rel=0.1)
    assert found.since < 0.05


@pytest.mark.parametrize(
    "values",
    [
        np.exp(30.0 * TIME),
        TIME * np.sin(60.0 * TIME),
        np.exp(3.0 * TIME) * np.sin(60.0 * TIME),
        1e3 * STEADY,
        np.where(np.arange(400) < 380, 0.0, 1.0),
        np.where(np.arange(400) < 10, 1.0, 1e9),
        1.0 / np.maximum(4.0 - TIME, 1e-9),
        np.zeros(400),
        STEADY * 0.9 ** np.arange(400),
        np.concatenate([1e-12 * 3.0 ** np.arange(20) * STEADY[:20], np.sin(TIME[:380])]),
        np.sin(3.1 * np.arange(400)) * np.sin(np.arange(400) / 7.0),
        np.concatenate([[1.0], np.zeros(380), 1e-3 * (-3.0) ** np.arange(8), np.zeros(11)]),
        STEADY * (1.0 + TIME),
        *((-3.0) ** np.arange(20), np.empty(0)),
    ],
)
def test_what_is_no_fault_of_the_coupling(values: np.ndarray) -> None:
    """Growth that the steps resolve, resonance, chatter, jumps, poles, rest, decay, rounding errors that alternate, beats,
    a vibration that comes up again and slow growth don't count; a few steps prove no instability."""
    time = TIME[: values.size]
    assert find_instability(time, [("a.y", values)]) is None
    if values.size != 20:
        assert find_alternation(time, [("a.y", values)]) is None
    assert find_alternation(time[:2], [("a.y", values[:2])]) is None


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
